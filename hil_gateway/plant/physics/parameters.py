"""Numbers of the simulated car, its road grip and its sensors. Sources and derivations: docs/plant.md."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from types import SimpleNamespace
from typing import Any

from hil_gateway.car.vehicle import GRAVITY

RPM = 0.10471975511965977
"""rad/s per revolution a minute"""
ENGINE_SPEEDS = tuple(rpm * RPM for rpm in (1500.0, 2500.0, 3500.0, 4500.0, 5500.0, 6110.0, 6800.0, 7400.0))
"""where the engine map has its points, rad/s"""
PAPER_BRAKES = 0.5 * 1.8e-3
"""N at an axle per Pa in both circuits, of the car that is nearly that of Eq. 1-3"""


@dataclass(frozen=True)
class CarParameters:
    """Physics of the car, SI. Every field is an input of the compiled physics, so changing one compiles nothing."""

    # mass and geometry
    mass: float = 787.3
    yaw_inertia: float = 1000.0
    lf: float = 1.724
    lr: float = 1.248
    cg_height: float = 0.275
    track_front: float = 1.638
    track_rear: float = 1.523
    wheel_radius: float = 0.3118
    wheel_inertia: float = 1.2
    """of one wheel about its axle, kg m2"""
    lever_arm: float = 1.0
    """share of the track width that enters wheel speeds and yaw moment; 0 makes the car as narrow as a single track"""
    # loads
    load_transfer: float = 1.0
    """share of the load transfer by the centre of gravity's height"""
    load_lag: float = 0.05
    """time constant of roll and pitch, s"""
    roll_share_front: float = 0.55
    """front axle's share of the roll moment"""
    # air
    drag: float = 0.516
    """rho Cd A / 2, N s2/m2"""
    side: float = 0.60
    """side force per v^2 at small air slip, N s2/m2"""
    downforce: float = 1.098
    """rho Cl A / 2 of both axles, N s2/m2"""
    downforce_share_front: float = 0.355
    wind_x: float = 0.0
    """air's velocity over ground, map frame, m/s"""
    wind_y: float = 0.0
    # tyres
    grip_front: float = 1.0
    """factor on the friction of the front tyres, both ways"""
    grip_rear: float = 1.0
    # magic formula, lateral, per axle
    bf: float = 11.0
    cf: float = 1.50
    df: float = 1.55
    ef: float = 0.10
    br: float = 13.0
    cr: float = 1.55
    dr: float = 1.60
    er: float = 0.10
    # tyres: longitudinal
    bx: float = 14.0
    cx: float = 1.60
    dx: float = 1.65
    ex: float = 0.10
    load_sensitivity: float = 0.12
    """relative loss of friction when the load doubles"""
    combined_slip: float = 1.0
    """0: longitudinal and lateral force know nothing of each other; 1: similarity method"""
    saturation: float = 1.0
    """0: longitudinal force linear in slip; 1: magic formula"""
    relaxation_y: float = 0.25
    """m of travel over which lateral slip builds up"""
    relaxation_x: float = 0.15
    rolling_resistance: float = 95.0
    """of the whole car, N"""
    turn_asymmetry: float = 0.0
    """relative gain of lateral force to the left, loss to the right"""
    yaw_damping: float = 0.0
    """moment against yaw, N m s"""
    # powertrain
    engine_torque: tuple[float, ...] = (310.0, 450.0, 545.0, 580.0, 578.0, 563.0, 505.0, 380.0)
    """full throttle at `ENGINE_SPEEDS`, N m (473 hp at 6110 rpm and driveline losses of 2 %)"""
    engine_speed_scale: float = 1.0
    """of those speeds"""
    engine_clutch: float = 2000.0 * RPM
    """the clutch slips below this engine speed, rad/s"""
    engine_drag: float = 600.0
    """force at the driven wheels with the throttle closed, N (45 N m of the engine in third gear)"""
    engine_inertia: float = 0.08
    driveline_efficiency: float = 0.98
    lsd_preload: float = 40.0
    """N m"""
    lsd_ramp: float = 0.25
    """locking torque over driving torque"""
    # brakes
    brake_gain_front: float = 2.75e-4
    """N m per wheel per Pa"""
    brake_gain_rear: float = 2.87e-4
    front_brake: float = 1.0
    """share of the front circuit's torque that acts on the front wheels; the rest acts on the rear ones"""
    # actuators
    steer_bandwidth: float = 18.85
    """rad/s, 3 Hz"""
    steer_rate: float = 0.5818
    """at the road wheel, rad/s: 500 deg/s of the motor at 15:1"""
    steer_max: float = 0.279
    brake_bandwidth: float = 31.4
    brake_rate: float = 1.8e8
    """Pa/s"""
    throttle_bandwidth: float = 31.4
    # what the steering really is against what is reported
    steer_offset: float = 0.0
    steer_scale: float = 1.0
    # late actuation beyond the reported one: 1 takes the delayed inputs instead of the actuator states
    steer_late: float = 0.0
    drive_late: float = 0.0

    @property
    def wheelbase(self) -> float:
        """m."""
        return self.lf + self.lr

    @property
    def static_load_front(self) -> float:
        """Front axle, level road, at rest, N."""
        return self.mass * GRAVITY * self.lr / self.wheelbase

    @property
    def static_load_rear(self) -> float:
        """Rear axle, level road, at rest, N."""
        return self.mass * GRAVITY * self.lf / self.wheelbase

    def vector(self) -> list[float]:
        """Values in the order of the fields, as the compiled physics takes them."""
        values = [getattr(self, field.name) for field in fields(self)]
        return [x for value in values for x in (value if isinstance(value, tuple) else (value,))]

    def symbols(self, vector: Any) -> Any:
        """The same names bound to the entries of a symbolic vector ordered as `vector()`."""
        names, start = {}, 0
        for field in fields(self):
            value = getattr(self, field.name)
            count = len(value) if isinstance(value, tuple) else 0
            names[field.name] = [vector[start + i] for i in range(count)] if count else vector[start]
            start += count or 1
        return SimpleNamespace(**names)


@dataclass(frozen=True)
class RoadParameters:
    """How much of the track file's slopes is real, and how grip changes."""

    grade: float = 1.0
    bank: float = 1.0
    grip_drift: float = 0.0
    """relative change of grip a second"""


@dataclass(frozen=True)
class SensorParameters:
    """Noise (standard deviations), quantisation and mounting of the sensors."""

    acceleration_noise: float = 0.11
    """m/s2"""
    yaw_rate_noise: float = 0.0015
    """rad/s"""
    speed_noise: float = 0.03
    """m/s"""
    position_noise: float = 0.02
    """m"""
    steer_noise: float = 2e-4
    """rad at the road wheel"""
    speed_scale: float = 1.0
    """reported over true speed"""
    imu_yaw: float = 0.0
    """mounting angle of the IMU about z, rad"""
    imu_x: float = 0.0
    """IMU ahead of the centre of gravity, m"""
    imu_bias_x: float = 0.0
    """m/s2"""
    imu_bias_y: float = 0.0


@dataclass(frozen=True)
class PlantParameters:
    """Everything that can be set about the simulated car."""

    car: CarParameters = CarParameters()
    road: RoadParameters = RoadParameters()
    sensors: SensorParameters = SensorParameters()
    gears: tuple[float, ...] = (2.917, 1.875, 1.381, 1.115, 0.96, 0.889)
    final_drive: float = 3.0
    shift_time: float = 0.05
    """s without drive torque"""
    steer_delay: float = 0.04
    brake_delay: float = 0.04
    pressure_max: float = 6.0e6
    """of its brakes, Pa"""
    throttle_delay: float = 0.02
    steer_late: float = 0.0
    """true road-wheel angle behind the reported one, s"""
    drive_late: float = 0.0


AV24 = PlantParameters()
"""The realistic car: everything on."""

PAPER = replace(
    AV24,
    car=replace(
        AV24.car,
        wheel_inertia=0.1,  # hardly any: it would add to the mass in everything longitudinal
        lever_arm=0.0,
        load_transfer=0.0,
        drag=0.0,
        side=0.0,
        downforce=0.0,
        ef=0.0,
        er=0.0,
        ex=0.0,
        load_sensitivity=0.0,
        combined_slip=0.0,
        saturation=0.0,
        relaxation_y=0.0,
        relaxation_x=0.05,
        rolling_resistance=0.0,
        engine_drag=0.0,
        engine_inertia=0.0,
        engine_torque=(300.0, 430.0, 520.0, 560.0, 566.0, 551.0, 490.0, 400.0),
        driveline_efficiency=1.0,
        brake_gain_front=PAPER_BRAKES * AV24.car.wheel_radius,
        brake_gain_rear=PAPER_BRAKES * AV24.car.wheel_radius,
        lsd_preload=0.0,
        lsd_ramp=0.0,
        front_brake=0.0,
    ),
    road=RoadParameters(grade=0.0, bank=0.0),
    shift_time=0.0,
)
"""As close to Eq. (1)-(3) as a car with four wheels gets: single effects can be studied on it."""

BASES: dict[str, PlantParameters] = {"av24": AV24, "paper": PAPER}

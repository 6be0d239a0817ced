"""Experiments on the plant alone: laps of the scripted driver with realistic sensors, as columns of a drive log."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.driving.driver import Driver
from hil_gateway.car.actuation import Actuation, ActuatorPositions
from hil_gateway.car.car import load_car
from hil_gateway.config import OriginConfig
from hil_gateway.plant.car import STEP_S, Car
from hil_gateway.plant.controller.sensors import Noise, SimulatedSensors
from hil_gateway.plant.physics.effects import configure
from hil_gateway.plant.physics.parameters import PlantParameters
from hil_gateway.plant.referee.referee import Referee
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track

STEPS_PER_SAMPLE = 10
START_SPEED = 20.0
COLUMNS = (
    "t", "x", "y", "yaw", "vx", "vy", "yaw_rate", "ax", "ay", "steer", "drive", "lap",
    "throttle", "brake", "gear", "engine_speed",
    "wheel_speed_fl", "wheel_speed_fr", "wheel_speed_rl", "wheel_speed_rr",
)  # fmt: skip


@dataclass(frozen=True)
class EstimateNoise:
    """Standard deviations of what a state estimator adds to the truth: m, rad, m/s."""

    position: float = 0.02
    yaw: float = 5e-4
    vx: float = 0.02
    vy: float = 0.02


@dataclass(frozen=True)
class Drive:
    """Columns at 100 Hz, shape (rows,), SI; and how it went."""

    columns: dict[str, Array]
    lap_times_s: tuple[float, ...]
    off_track: int


def drive(
    effects: Mapping[str, float] | None = None,
    *,
    base: str = "paper",
    laps: int = 8,
    seconds: float = math.inf,
    start_s: float = 0.0,
    seed: int = 1,
    track: Track | str | None = None,
    levels: tuple[float, float] = (0.45, 0.85),
    noise: EstimateNoise | None = None,
    parameters: PlantParameters | None = None,
) -> Drive:
    """Drive `laps` laps (or `seconds`) from `start_s`, each faster: from the first to the second share of the grip.

    `drive` is the slip-ratio command equivalent to the reported pedals, as the gateway derives it. `parameters`
    replaces base and effects. Ends early when the car leaves the road for good.

    Raises:
        InputError: unknown effect or base, size out of range, broken track.
    """
    where = track if isinstance(track, Track) else load_track(track)
    car = Car(parameters or configure(base, effects), where, start_s, START_SPEED)
    recorder = _Recorder(car, seed, noise or EstimateNoise())
    driver = Driver(car, load_car().vehicle, levels[0])
    referee = Referee(car)
    pace = np.linspace(levels[0], levels[1], laps)
    while referee.laps < laps and abs(car.road.lateral) < 30.0 and car.time_s < min(seconds, 400.0 * laps):
        driver.set_level(float(pace[referee.laps]))
        commands = driver(round(car.time_s * NS_PER_S))
        for _ in range(STEPS_PER_SAMPLE):
            car.step(commands, engine_running=True)
            referee.loads.step()
        referee.step(car.time_s)
        recorder.take(referee.laps)
    return Drive(recorder.columns(), tuple(referee.lap_times_s), referee.off_track_count)


class _Recorder:
    """One row a sample: sensors where there is one, the true motion with an estimator's noise elsewhere."""

    def __init__(self, car: Car, seed: int, noise: EstimateNoise) -> None:
        self._car = car
        self._sensors = SimulatedSensors(car, car.parameters.sensors, load_car(), OriginConfig(), seed)
        self._noise, self._draw = noise, Noise(seed + 1_000_003)
        train = load_car().powertrain
        self._actuation = Actuation(load_car().vehicle, train)
        self._rows: list[tuple[float, ...]] = []

    def take(self, lap: int) -> None:
        """Add a row."""
        car, e, z = self._car, self._noise, self._draw
        imu, wheels = self._sensors.imu("main"), self._sensors.wheel_speeds()
        engine_speed = car.output("engine_speed")
        front, rear = car["brake_front"], car["brake_rear"]
        pedals = ActuatorPositions(0.0, car["throttle"], front, rear, car.gear)
        scale = car.parameters.sensors.speed_scale
        self._rows.append(
            (
                car.steps * STEP_S,
                car["x"] + e.position * z(),
                car["y"] + e.position * z(),
                car["yaw"] + e.yaw * z(),
                scale * car["vx"] + e.vx * z(),
                car["vy"] + e.vy * z(),
                imu["imu.main.yaw_rate"],
                imu["imu.main.ax"],
                imu["imu.main.ay"],
                self._sensors.steering(),
                self._actuation.to_drive(pedals, engine_speed, car.gear),
                float(lap),
                car["throttle"],
                0.5 * (front + rear),
                float(car.gear),
                engine_speed,
                wheels["wheel_speed_fl"],
                wheels["wheel_speed_fr"],
                wheels["wheel_speed_rl"],
                wheels["wheel_speed_rr"],
            )
        )

    def columns(self) -> dict[str, Array]:
        """Name -> (rows,)."""
        table = np.array(self._rows).reshape(-1, len(COLUMNS))
        return {name: table[:, i].copy() for i, name in enumerate(COLUMNS)}

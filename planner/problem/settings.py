"""Weights, limits and switches of the planner; what is a fact of the car comes from its folder."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from estimator.model.measurement import MeasurementKind
from hil_gateway.car.car import Car
from hil_gateway.config import Config
from hil_gateway.settings.gateway import CommandRates, LimitConfig
from planner.problem.brake_law import BrakeLaw

LoadLimit = Literal["ellipse", "literal"]
Convexification = Literal["abs", "projection"]
Criterion = Literal["trace", "log_det"]


@dataclass(frozen=True)
class Weights:
    """Weights of Eq. (4); inputs changes are a stage, in units of their bound."""

    contouring: float = 0.1
    """q_c, 1/m2"""
    lag: float = 20.0
    """q_l, 1/m2"""
    edge: float = 30.0
    """on the way into `PlanLimits.edge_zone`, 1/m2: the closed loop across the track answers within 0.1 s, what
    steering and its dead time can do. A bound alone is answered as hard as the actuators can: cars that turn quicker
    than their model wove along it by 9 mrad of steering"""
    progress: float = 0.2
    """q_v, s/m"""
    drive_change: float = 0.05
    steer_change: float = 2.0
    progress_change: float = 0.01
    """diagonal of R on changes divided by their bounds"""
    lateral_speed: float = 0.02
    yaw_rate: float = 0.5
    """slight damping of v_y and omega: without it one SQP iteration a step lost the car near 60 m/s"""
    regularisation: float = 1e-4
    """added to the diagonal of every Hessian"""
    proximal: float = 0.3
    """weight on the step of an input change from one iteration to the next, in units of its bound, in the Hessian
    only: what the Gauss-Newton Hessian leaves out (curvature of active load rows) would let steps oscillate"""


@dataclass(frozen=True)
class PlanLimits:
    """Actuator and state limits of Eq. (4); rates are per second."""

    steer: float
    steer_rate: float
    drive_max: float
    drive_min: float
    """what both axles take at speed with downforce; the load rows know what they take at each"""
    drive_rate: float
    speed: float
    power: float
    """engine power at the wheels, W: bounds the drive command at speed"""
    car_half_width: float
    progress_rate: float = 25.0
    track_margin: float = 0.3
    """kept clear of the edge beyond the car's own width, m"""
    edge_zone: float = 0.35
    """m inside of that, entered against a rising force only; the race line stays out of it"""
    exploring_margin: float = 0.3
    """kept clear beyond that where information is paid for, m: a slalom with wrong tyres ends up to 0.3 m wide"""
    exploring_reserve: float = 0.1
    """of the load limits, left alone beyond what tyres not yet known are owed, while information is paid for: a slalom
    at 50 m/s swings the rear axle 7 % beyond what was asked, and who brakes out of one with 0.03 locks the inner front
    wheel"""

    @property
    def race_line_margin(self) -> float:
        """Least distance of the race line from the edges, m."""
        return self.car_half_width + self.track_margin + self.edge_zone


STEER_SHARE = 0.93
"""of the steering's range that is planned with: the rest is for what corrects"""
STEER_RATE = 0.3
"""rad/s at the road wheel, planned at most: quicker steering is seen by the plan as noise"""
FULL_BRAKING_S = 0.225
"""from coasting to full braking: quicker braking is seen by the plan as noise"""


def limits_of(car: Car, rates: CommandRates) -> PlanLimits:
    """What the car can do, within what the gateway lets out."""
    train, ratio = car.powertrain, car.vehicle.steering_ratio
    drive_min = -train.braking_max / train.force_per_drive
    return PlanLimits(
        steer=STEER_SHARE * car.actuators.steering_range,
        steer_rate=min(STEER_RATE, rates.steering / ratio),
        drive_max=train.traction_max / train.force_per_drive,
        drive_min=drive_min,
        drive_rate=-drive_min / FULL_BRAKING_S,
        speed=car.actuators.speed_max,
        power=train.power_max * train.driveline_efficiency,
        car_half_width=car.vehicle.half_width,
    )


@dataclass(frozen=True)
class Slack:
    """L1 and L2 penalties on soft rows."""

    track: tuple[float, float] = (300.0, 800.0)
    load: tuple[float, float] = (200.0, 1000.0)
    speed: tuple[float, float] = (0.01, 5.0)
    information: tuple[float, float] = (20.0, 100.0)


@dataclass(frozen=True)
class Information:
    """Eq. (9): weight q_I, bound on Delta I a stage, criterion, measurement model."""

    weight: float = 0.0
    goal: float = 0.0
    """exploring ends when the belief's spread over the prior's, in the geometric mean, is this small; 0: never"""
    bound: float = 400.0
    criterion: Criterion = "trace"
    kind: MeasurementKind = "tyre_force"
    convexification: Convexification = "abs"


@dataclass(frozen=True)
class Settings:
    """Everything that shapes the optimal-control problem."""

    limits: PlanLimits
    brakes: BrakeLaw
    horizon: int = 40
    dt: float = 0.05
    weights: Weights = Weights()
    slack: Slack = Slack()
    information: Information = Information()
    load_limit: LoadLimit = "ellipse"
    sigma_level: float = 2.0
    """Eq. (10) holds at the mean and at this many standard deviations along each principal axis of the belief"""

    @property
    def iterations(self) -> int:
        """SQP iterations a step: one (real-time iteration), two with information."""
        return 2 if self.information.weight > 0 else 1


def declared_settings(car: Car) -> Settings:
    """Settings for a car that moves as fast as it can."""
    return Settings(limits_of(car, LimitConfig().within(car)), BrakeLaw(car.vehicle, car.powertrain))


def settings_of(config: Config) -> Settings:
    """Settings of the optimal-control problem from the configuration."""
    p = config.planner
    information = Information(
        weight=p.information_weight, goal=p.information_goal, bound=p.information_bound,
        criterion=p.information_criterion, kind=config.estimator.measurement, convexification=p.convexification,
    )  # fmt: skip
    return Settings(
        horizon=p.horizon,
        dt=p.dt,
        information=information,
        load_limit=p.load_limit,
        limits=limits_of(config.declared_car, config.gateway.limits.within(config.declared_car)),
        brakes=BrakeLaw(config.vehicle, config.powertrain),
        sigma_level=p.sigma_level,
    )

"""Motion and measurements of the state filter as expressions: what it predicts, and what each sensor says.

Written down once; CasADi derives the Jacobians, and a whole step is one compiled call. The numbers of a car are inputs:
nothing is compiled anew for another one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from math import hypot
from typing import Any, NamedTuple

import casadi as ca

from hil_gateway.car.car import Car, Receiver
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.observer.kalman import scalar_update, symmetric
from hil_gateway.process.arrays import Expr
from hil_gateway.process.compiled import EXACT_LOOPS, CompiledFunction, compile_function

STATES = (
    "x",
    "y",
    "yaw",
    "vx",
    "vy",
    "bias_ax",
    "bias_ay",
    "bias_yaw_rate",
    "wheel_scale",
    "grade_share",
    "bank_share",
    "imu_turn",
    "imu_ahead",
    "drift_x",
    "drift_y",
    "heading_turn",
)
(
    X, Y, YAW, VX, VY, BIAS_AX, BIAS_AY, BIAS_YAW_RATE, WHEEL_SCALE, GRADE_SHARE, BANK_SHARE,
    IMU_TURN, IMU_AHEAD, DRIFT_X, DRIFT_Y, HEADING_TURN,
) = range(len(STATES))  # fmt: skip


class FilterCar(NamedTuple):
    """What the steps know of a car, SI."""

    lf: Expr
    lr: Expr
    rear_slip_yield: Expr
    """slip angle of the rear axle, rad, a m/s2 of lateral force: what a car on a bank creeps downhill"""
    accel: Expr
    """standard deviations of its sensors, white ones per sample: m/s2"""
    yaw_rate: Expr
    wheel_speed: Expr
    """per axle, m/s"""
    position: Expr
    """of a fix by itself, m: what the next fix does not share"""
    position_wander: Expr
    """m per square root of a second"""


def filter_car(car: Car, receiver: Receiver) -> FilterCar:
    """By what is declared, with linear tyres; `receiver` places it."""
    vehicle, tyres, imu, n = car.vehicle, car.tyres, next(iter(car.imus.values())), FilterNoise()
    return FilterCar(
        vehicle.lf, vehicle.lr, 1.0 / (tyres.br * tyres.cr * tyres.dr * GRAVITY),
        hypot(imu.acceleration_noise, n.vibration), hypot(imu.rate_noise, n.vibration_rate),
        car.sensors.wheel_speed_noise, hypot(receiver.noise, n.position),
        hypot(receiver.wander * (2.0 / receiver.wander_time) ** 0.5, n.position_wander),
    )  # fmt: skip


@dataclass(frozen=True)
class FilterNoise:
    """Standard deviations beyond what the car folder states; white ones per sample at the IMU rate, SI."""

    vibration: float = 0.11
    """m/s2, of body and engine"""
    vibration_rate: float = 0.0036
    """rad/s"""
    accel_model: float = 0.15
    """what the map leaves out of gravity, m/s2 per sample"""
    bias_accel_walk: float = 0.01
    """m/s2 per square root of a second"""
    bias_yaw_rate_walk: float = 2e-5
    """rad/s per square root of a second, 100 degrees an hour within 10 minutes: an automotive unit that warms up"""
    wheel_scale_walk: float = 5e-4
    slope_share_walk: float = 0.01
    imu_turn_walk: float = 1e-4
    """rad per square root of a second: a mounting that settles"""
    imu_ahead_walk: float = 1e-3
    """m per square root of a second: a centre of gravity that moves with the fuel"""
    position: float = 0.022
    """m: the antenna's way as the body moves"""
    position_wander: float = 0.04
    """m per square root of a second, 0.3 m a minute: corrections whose ambiguities are not resolved (float RTK)"""
    position_drift: float = 0.01
    """m/s at which fixes lead away for longer, and"""
    position_drift_s: float = 300.0
    """s, for how long: orbits, clocks and ionosphere of a receiver without corrections"""
    position_delay: float = 0.006
    """s: a fix whose frame just misses a state comes with the next one, 10 ms older"""
    heading: float = 0.005
    """of a receiver that states none, rad: two antennas 2 m apart, each to 1 cm"""
    heading_turn_walk: float = 2e-4
    """rad per square root of a second: of an inertial solution 0.08 degrees that wander within 100 s"""
    wheel_rolling: float = 0.01
    """share of the speed by which a wheel that rolls freely may go wrong, with what stays correlated from sample to
    sample"""
    wheel_slip: float = 0.6
    """share of vx * drive by which a driven or braked wheel may slip unseen"""
    rear_slip: float = 0.03
    """rear slip angle on a straight, with what stays correlated from sample to sample, rad"""
    rear_slip_per_ay: float = 0.05
    """error of the above, with what stays correlated from sample to sample, rad per m/s2"""
    initial_position: float = 0.3
    initial_yaw: float = 0.3
    initial_speed: float = 0.5
    initial_slope_share: float = 0.5
    initial_heading_turn: float = 0.01
    """rad: what is left of how a receiver's axes, or the line of its antennas, are declared"""


GATE = 5.0**2
"""limit of a normalised innovation squared: five standard deviations"""
GATE_POSITION = 25.0
"""the same of a position fix, two degrees of freedom: one in 3e5 good fixes is refused"""


@dataclass
class FilterMoment:
    """Symbolic mean (n,), covariance (n, n) and yaw rate; `nis` gathers normalised innovations squared."""

    mean: Expr
    covariance: Expr
    yaw_rate: Expr
    car: FilterCar
    noise: FilterNoise = FilterNoise()
    nis: list[Expr] = field(default_factory=list)

    def update(self, H: Expr, innovation: Expr, variance: Expr, spread: Expr = 0.0) -> None:
        """Take in a measurement with row `H` (1, n); `spread`: variance of an innovation that is a mean of several."""
        K, covariance = scalar_update(self.covariance, H, variance)
        self.covariance = covariance + spread * (K @ K.T)
        self.mean = self.mean + K * innovation
        self.yaw_rate = self.yaw_rate - K[BIAS_YAW_RATE] * innovation

    def gated(self, H: Expr, innovation: Expr, variance: Expr) -> None:
        """The same unless the innovation is an outlier."""
        before = self.mean, self.covariance, self.yaw_rate
        nis = innovation**2 / (H @ self.covariance @ H.T + variance)
        self.update(H, innovation, variance)
        self.keep_if(nis, GATE, before)

    def unsigned(self, H: Expr, expected: Expr, reading: Expr, variance: Expr) -> None:
        """Take in the magnitude of a speed with row `H` (1, n) that is `expected`, by a sensor that knows no direction.

        The reading has either sign, each as likely as the speed expected makes it; mean and covariance are those of the
        mixture of both (probabilistic data association, Bar-Shalom and Li, Multitarget-Multisensor Tracking, ch. 3).
        """
        before = self.mean, self.covariance, self.yaw_rate
        S = H @ self.covariance @ H.T + variance
        sign = ca.tanh(expected * reading / S)
        self.update(H, sign * reading - expected, variance, (1.0 - sign**2) * reading**2)
        self.keep_if((reading - ca.fabs(expected)) ** 2 / S, GATE, before)

    def keep_if(self, nis: Expr, gate: float, before: tuple[Expr, Expr, Expr]) -> None:
        """Go back to `before` where `nis` is not below `gate` (not-a-number is not)."""
        after = self.mean, self.covariance, self.yaw_rate
        self.mean, self.covariance, self.yaw_rate = (
            ca.if_else(nis < gate, new, old) for new, old in zip(after, before, strict=True)
        )
        self.nis.append(nis)


Step = Callable[..., None]
"""step(moment, *measured) moves `moment` on"""


@cache
def step_function(step: Step, measured: int) -> CompiledFunction:
    """(mean, covariance, yaw rate, measured, `FilterCar`) to the same after `step`, and its normalised innovations
    squared; made once a process, to be used by its `twin`."""
    n, sym = len(STATES), ca.MX.sym
    u, car = sym("measured", measured), sym("car", len(FilterCar._fields))
    start = sym("mean", n), sym("covariance", n, n), sym("yaw_rate")
    moment = FilterMoment(*start, FilterCar(*ca.vertsplit(car)))
    step(moment, *ca.vertsplit(u))
    end = [moment.mean, moment.covariance, moment.yaw_rate, ca.vertcat(*moment.nis) if moment.nis else ca.MX(0, 1)]
    function = ca.Function(step.__name__, [*start, u, car], [ca.densify(e) for e in end])
    return compile_function(function, flags=EXACT_LOOPS)


def predict(moment: FilterMoment, *imu: Expr) -> None:
    """Strap-down step over dt s, second order in it.

    ax, ay, yaw rate held; gravity along the body's axes; dt; 1, or 0 of a car that stands; variances of force and yaw
    rate beyond the noise. The forces act on the velocity where the IMU is, which moves to the side as the
    car turns. The place is the one the fixes give, which wander and drift.
    """
    given = ca.vertcat(*imu), ca.vertcat(*moment.car)
    before = moment.mean, moment.covariance, moment.yaw_rate
    moment.mean, moment.covariance, moment.yaw_rate = _motion(moment.noise)(*before, *given)


@cache
def _motion(n: FilterNoise) -> ca.Function:
    """(mean, covariance, yaw rate, what `predict` is given, `FilterCar`) to the first three after the step: mostly
    zeros, which loops would not leave out."""
    P = ca.SX.sym("covariance", len(STATES), len(STATES))
    m, before, imu = ca.SX.sym("mean", len(STATES)), ca.SX.sym("before"), ca.SX.sym("imu", 9)
    known = ca.SX.sym("car", len(FilterCar._fields))
    car = FilterCar(*ca.vertsplit(known))
    ax, ay, gyro, gravity_x, gravity_y, dt, moves, accel_variance, rate_variance = ca.vertsplit(imu)
    x, y, yaw, vx, vy, bias_ax, bias_ay, bias_yaw_rate, _, grade, bank, turn, ahead, *drift, _ = ca.vertsplit(m)
    drift_x, drift_y = drift
    rate = gyro - bias_yaw_rate
    r = moves * rate
    # known by difference: a bias is not in it, and what noise adds the next step takes away again
    change = ca.SX.sym("change")
    felt_x, felt_y = levelled(ax - bias_ax, ay - bias_ay, ca.cos(turn), ca.sin(turn))
    fx, fy = felt_x + grade * gravity_x, felt_y + bank * gravity_y
    c, s = ca.cos(r * dt), ca.sin(r * dt)
    # the specific force turns with the body: over the step it acts half a turn later than at the start
    ch, sh = ca.cos(0.5 * r * dt) * dt, ca.sin(0.5 * r * dt) * dt
    vx1 = c * vx + s * (vy + ahead * r) + ch * fx + sh * fy
    vy1 = -s * vx + c * vy - sh * fx + ch * fy - ahead * change
    forward, left, course = 0.5 * moves * (vx + vx1), 0.5 * moves * (vy + vy1), yaw + 0.5 * r * dt
    cy, sy = ca.cos(course), ca.sin(course)
    east, north = cy * forward - sy * left + drift_x, sy * forward + cy * left + drift_y
    kept = ca.exp(-dt / n.position_drift_s)
    after = ca.vertcat(
        x + dt * east, y + dt * north, yaw + r * dt, vx1, vy1, m[BIAS_AX : DRIFT_X], kept * drift_x, kept * drift_y,
        m[HEADING_TURN],
    )  # fmt: skip
    F, G = ca.jacobian(after, m), ca.jacobian(after, ca.vertcat(ax, ay, gyro))
    after, F, G = ca.substitute([after, F, G], [change], [rate - before])
    white = car.accel**2 + n.accel_model**2 + accel_variance
    noise = G @ ca.diag(ca.vertcat(white, white, car.yaw_rate**2 + rate_variance)) @ G.T
    noise += _walks(n, car.position_wander, dt)
    return ca.Function("motion", [m, P, before, imu, known], [after, symmetric(F @ P @ F.T + noise), rate])


def levelled(ax: Any, ay: Any, cos: Any, sin: Any) -> tuple[Any, Any]:
    """Specific force in the car's axes of what a unit reads that is turned to the left by an angle of such cos, sin."""
    return cos * ax - sin * ay, sin * ax + cos * ay


def _walks(n: FilterNoise, wander: Expr, dt: Expr) -> Expr:
    """Covariance of the random walks over `dt` s."""
    drift = n.position_drift * (2.0 / n.position_drift_s) ** 0.5
    walk = (
        wander, wander, 0.0, 0.0, 0.0, n.bias_accel_walk, n.bias_accel_walk,
        n.bias_yaw_rate_walk, n.wheel_scale_walk, n.slope_share_walk, n.slope_share_walk, n.imu_turn_walk,
        n.imu_ahead_walk, drift, drift, n.heading_turn_walk,
    )  # fmt: skip
    return ca.diag(ca.vertcat(*walk) ** 2) * dt


def position(moment: FilterMoment, x: Expr, y: Expr) -> None:
    """Position fix of the CoG: gated as a whole, then taken along and across the car, less certain along a fast one."""
    before, n = (moment.mean, moment.covariance, moment.yaw_rate), moment.noise
    c, s = ca.cos(moment.mean[YAW]), ca.sin(moment.mean[YAW])
    white = moment.car.position**2
    variances = white + (n.position_delay * moment.mean[VX]) ** 2, white
    rows = _row({X: c, Y: s}), _row({X: -s, Y: c})

    def off() -> list[Expr]:
        ex, ey = x - moment.mean[X], y - moment.mean[Y]
        return [c * ex + s * ey, c * ey - s * ex]

    (along, across), H = off(), ca.vertcat(*rows)
    S = H @ moment.covariance @ H.T + ca.diag(ca.vertcat(*variances))
    nis = (along**2 * S[1, 1] - 2 * along * across * S[0, 1] + across**2 * S[0, 0]) / (S[0, 0] * S[1, 1] - S[0, 1] ** 2)
    for k, (row, variance) in enumerate(zip(rows, variances, strict=True)):
        moment.update(row, off()[k], variance)
    moment.keep_if(nis, GATE_POSITION, before)


def heading(moment: FilterMoment, yaw: Expr, std: Expr) -> None:
    """Where a receiver points, rad, whose axes are turned against those of the car."""
    off = yaw - moment.mean[YAW] - moment.mean[HEADING_TURN]
    moment.gated(_row({YAW: 1.0, HEADING_TURN: 1.0}), ca.atan2(ca.sin(off), ca.cos(off)), std**2)


def wheel_speeds(moment: FilterMoment, front: Expr, rear: Expr, steer: Expr, drive: Expr) -> None:
    """Mean circumferential speeds of front and rear wheels, without direction; slip widens their noise."""
    m, n, lf, c, s = moment.mean, moment.noise, moment.car.lf, ca.cos(steer), ca.sin(steer)
    speed = ca.fabs(m[VX])
    slip, free = n.wheel_slip * speed * drive, moment.car.wheel_speed**2 + (n.wheel_rolling * speed) ** 2
    scale, rolling = 1.0 + m[WHEEL_SCALE], m[VX] * c + (m[VY] + lf * moment.yaw_rate) * s
    H = _row({VX: c * scale, VY: s * scale, BIAS_YAW_RATE: -lf * s * scale, WHEEL_SCALE: rolling})
    moment.unsigned(H, rolling * scale, front, free + ca.fmin(slip, 0.0) ** 2)
    m = moment.mean
    scale = 1.0 + m[WHEEL_SCALE]
    moment.unsigned(_row({VX: scale, WHEEL_SCALE: m[VX]}), m[VX] * scale, rear, free + slip**2)


def rear_slip(moment: FilterMoment, ay: Expr) -> None:
    """The rear axle yields to a side force: vy - l_r r = -yield ay |vx|, the less certain the more the car corners."""
    m, n, lr, speed = moment.mean, moment.noise, moment.car.lr, ca.fabs(moment.mean[VX])
    std = (n.rear_slip + n.rear_slip_per_ay * ca.fabs(ay)) * speed + 0.05
    expected = lr * moment.yaw_rate - moment.car.rear_slip_yield * ay * speed
    moment.gated(_row({VY: 1.0, BIAS_YAW_RATE: lr}), expected - m[VY], std**2)


def standstill(moment: FilterMoment, *imu: Expr) -> None:
    """The car stands: no yaw rate; the gyro and the accelerometers show their biases."""
    n, (ax, ay, gyro, gravity_x, gravity_y) = moment.noise, imu
    moment.update(_row({BIAS_YAW_RATE: 1.0}), gyro - moment.mean[BIAS_YAW_RATE], moment.car.yaw_rate**2)
    variance = 10 * (moment.car.accel**2 + n.accel_model**2)
    level(moment, ax, ay, gravity_x, gravity_y, variance, variance)


def level(moment: FilterMoment, *read: Expr) -> None:
    """What the accelerometers read of a car at rest, and its variance: bias less gravity."""
    ax, ay, gravity_x, gravity_y, variance_x, variance_y = read
    rows = (
        (BIAS_AX, GRADE_SHARE, ax, gravity_x, variance_x),
        (BIAS_AY, BANK_SHARE, ay, gravity_y, variance_y),
    )
    for bias, share, force, gravity, variance in rows:
        H = _row({bias: 1.0, share: -gravity})
        moment.update(H, force - H @ moment.mean, variance)


def _row(entries: dict[int, Expr]) -> Expr:
    """A measurement's row of the Jacobian, sparse (1, n)."""
    row = ca.MX(1, len(STATES))
    for index, value in entries.items():
        row[0, index] = value
    return row

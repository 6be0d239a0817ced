"""Inertial navigation of the car: extended Kalman filter on IMU, wheel speeds, steering and position fixes.

The IMU drives the prediction, so the filter does not depend on the tyre model it is meant to help identify. State:

    x, y, yaw                      map frame as the receiver has it, m and rad
    vx, vy                         body frame at the CoG, m/s
    bias_ax, bias_ay, bias_yaw_rate    IMU biases, m/s2 and rad/s
    wheel_scale                    (indicated wheel speed) / (true) - 1: rolling radius
    grade_share, bank_share        shares of the declared track map's grade and bank that are real
    imu_turn                       angle of the IMU about the vertical axis, rad
    imu_ahead                      distance of the IMU ahead of the CoG, beyond what is declared, m
    drift_x, drift_y               velocity at which the fixes lead away from the car, m/s
    heading_turn                   angle of a receiver's heading to the left of the car's, rad: mounting, slow error

Errors of position fixes are no white noise: they wander and drift. The place is therefore the one the fixes give, and
how it wanders is noise of the prediction: fixes of a car that stands move it and do not turn it.
The yaw rate is the bias-corrected gyro. Gravity on grade and bank comes from the declared track map, which may be
wrong as a whole (a flat road under a hilly map), and grade apart from bank, which are surveyed by other means: the
shares of them that are real are estimated too. Every measurement is
gated by its normalised innovation squared (Bar-Shalom, Estimation with Applications to Tracking, ch. 5).
"""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import NamedTuple

import numpy as np

from estimator.state import filter_steps
from estimator.state.filter_steps import (
    BANK_SHARE,
    BIAS_AX,
    BIAS_AY,
    BIAS_YAW_RATE,
    GRADE_SHARE,
    HEADING_TURN,
    IMU_AHEAD,
    IMU_TURN,
    STATES,
    VX,
    FilterNoise,
    Step,
    X,
    Y,
    filter_car,
    levelled,
    step_function,
)
from hil_gateway.car.car import Car, Receiver
from hil_gateway.process.arrays import Array, finite
from hil_gateway.process.compiled import CompiledFunction

YAW_ACCELERATION_S = 0.05
"""time constant, s: noise of the gyro's differences"""


class ImuReading(NamedTuple):
    """One IMU sample with gravity along the body axes from the track map, m/s2 and rad/s."""

    ax: float
    ay: float
    yaw_rate: float
    gravity_x: float = 0.0
    gravity_y: float = 0.0


class Unseen(NamedTuple):
    """Standard deviations of what a sample may differ by from the motion, beyond its noise, m/s2 and rad/s."""

    accel: float = 0.0
    yaw_rate: float = 0.0


SEEN = Unseen()


class StateFilter:
    """Mean and covariance of `STATES`; `initialise` first, then `predict` and updates in order of time."""

    def __init__(self, car: Car, receiver: Receiver | None = None) -> None:
        """`receiver` that places the car; its first one where none is given."""
        placing = receiver or next(iter(car.receivers.values()))
        self.car, self.noise, imu = filter_car(car, placing), FilterNoise(), next(iter(car.imus))
        self.declared = {
            "bias_ax": car.std(f"imu.{imu}.acceleration_offset"), "bias_ay": car.std(f"imu.{imu}.acceleration_offset"),
            "bias_yaw_rate": car.std(f"imu.{imu}.rate_offset"), "wheel_scale": car.relative_std("vehicle.wheel_radius"),
            "imu_turn": car.std(f"imu.{imu}.yaw"), "imu_ahead": car.std(f"imu.{imu}.x"),
        }  # fmt: skip
        """how well the car folder knows states"""
        self.mean = np.zeros(len(STATES))
        self.covariance = np.eye(len(STATES))
        self.yaw_rate = self._yaw_acceleration = 0.0
        self.rejected = 0
        self._predict = self._step(filter_steps.predict, 9)
        self._position = self._step(filter_steps.position, 2)
        self._heading = self._step(filter_steps.heading, 2)
        self._wheel_speeds = self._step(filter_steps.wheel_speeds, 4)
        self._rear_slip = self._step(filter_steps.rear_slip, 1)
        self._standstill = self._step(filter_steps.standstill, 5)
        self._level = self._step(filter_steps.level, 6)

    def _step(self, step: Step, measured: int) -> CompiledFunction:
        function = step_function(step, measured).twin()
        function.arguments[4][:] = self.car
        return function

    def initialise(self, x: float, y: float, yaw: float, vx: float = 0.0, **std: float) -> None:
        """Start at a position fix; `NAME_std` says how wrong a state may be, where that is not the usual."""
        n, self.mean = self.noise, np.zeros(len(STATES))
        self.mean[:4], self.mean[[GRADE_SHARE, BANK_SHARE]] = (x, y, yaw, vx), 1.0
        usual = {
            "x": n.initial_position, "y": n.initial_position, "yaw": n.initial_yaw,
            "vx": n.initial_speed, "vy": n.initial_speed + 0.1 * abs(vx),
            "grade_share": n.initial_slope_share, "bank_share": n.initial_slope_share, **self.declared,
            "drift_x": n.position_drift, "drift_y": n.position_drift, "heading_turn": n.initial_heading_turn,
        }  # fmt: skip
        self.covariance = np.diag([std.get(f"{name}_std", usual[name]) ** 2 for name in STATES])

    def align(self, yaw: float, yaw_std: float, gravity_x: float, gravity_y: float) -> None:
        """Start at the place with a heading; speed, gyro bias and what the accelerometers read at rest stay known."""
        (x, y, _, vx), forces, gyro = self.mean[:4], self.mean[BIAS_AX : BIAS_AY + 1], self.mean[BIAS_YAW_RATE]
        std = self.std()
        known = {f"{STATES[i]}_std": std[i] for i in (X, Y, VX, BIAS_YAW_RATE)}
        self.initialise(x, y, yaw, vx, yaw_std=yaw_std, **known)
        self.mean[BIAS_YAW_RATE] = gyro
        variances = (std[BIAS_AX : BIAS_AY + 1] ** 2).tolist()
        self._apply(self._level, *forces.tolist(), gravity_x, gravity_y, *variances)

    def place(self, x: float, y: float) -> None:
        """Be where a fix is, whatever was known of the place."""
        self.mean[[X, Y]] = x, y
        self._forget([X, Y], self.noise.initial_position)

    def change_receiver(self) -> None:
        """Headings come from another receiver, whose axes are turned otherwise."""
        self.mean[HEADING_TURN] = 0.0
        self._forget([HEADING_TURN], self.noise.initial_heading_turn)

    def _forget(self, states: list[int], std: float) -> None:
        """All that is known of these is their deviation."""
        self.covariance[states], self.covariance[:, states] = 0.0, 0.0
        self.covariance[states, states] = std**2

    def predict(self, imu: ImuReading, dt: float, unseen: Unseen = SEEN, *, moves: bool = True) -> None:
        """Strap-down step over `dt` s, second order in it; a car that stands (`moves` false) only gathers speed."""
        before = self.yaw_rate
        sample = imu.ax, imu.ay, imu.yaw_rate, imu.gravity_x, imu.gravity_y
        self._apply(self._predict, *sample, dt, moves, unseen.accel**2, unseen.yaw_rate**2)
        change = (self.yaw_rate - before) / dt - self._yaw_acceleration
        self._yaw_acceleration += dt / (YAW_ACCELERATION_S + dt) * change

    def update_position(self, x: float, y: float) -> float | None:
        """Position fix of the CoG, m. Returns the normalised innovation squared, None where it was gated out."""
        used = self._gated(self._position, filter_steps.GATE_POSITION, x, y)
        return used[0] if used else None

    def update_heading(self, yaw: float, std: float | None) -> float | None:
        """Where a receiver points, and the deviation it states, rad. Returns the NIS, None where it was gated out."""
        used = self._gated(self._heading, filter_steps.GATE, yaw, std or self.noise.heading)
        return used[0] if used else None

    def update_wheel_speeds(self, front: float, rear: float, steer: float, drive: float) -> list[float]:
        """Mean circumferential speeds of front and rear wheels, m/s, >= 0 either way. Returns the NIS used."""
        return self._gated(self._wheel_speeds, filter_steps.GATE, front, rear, steer, drive)

    def update_rear_slip(self, ay: float) -> float | None:
        """The rear axle hardly slides on a straight: vy - l_r r = 0, the less certain the more the car corners."""
        used = self._gated(self._rear_slip, filter_steps.GATE, ay)
        return used[0] if used else None

    def update_standstill(self, imu: ImuReading) -> None:
        """The car stands: no yaw rate; the gyro and the accelerometers show their biases."""
        self._apply(self._standstill, imu.ax, imu.ay, imu.yaw_rate, imu.gravity_x, imu.gravity_y)

    def specific_force(self, ax: float, ay: float) -> tuple[float, float]:
        """At the CoG, along the car's axes, m/s2, from what the accelerometers read."""
        m: list[float] = self.mean.tolist()
        fx, fy = levelled(ax - m[BIAS_AX], ay - m[BIAS_AY], cos(m[IMU_TURN]), sin(m[IMU_TURN]))
        return fx + m[IMU_AHEAD] * self.yaw_rate**2, fy - m[IMU_AHEAD] * self._yaw_acceleration

    def std(self) -> Array:
        """Standard deviations of `STATES`, shape (n,)."""
        return np.sqrt(np.maximum(self.covariance.diagonal(), 0.0))

    @property
    def yaw_rate_std(self) -> float:
        """Of the bias-corrected gyro, rad/s."""
        return sqrt(max(float(self.covariance[BIAS_YAW_RATE, BIAS_YAW_RATE]), 0.0) + self.car.yaw_rate**2)

    @property
    def healthy(self) -> bool:
        """Finite mean and covariance."""
        return finite(self.mean, self.covariance)

    def _gated(self, function: CompiledFunction, gate: float, *measured: float) -> list[float]:
        """Apply an update; the normalised innovations squared within `gate`, the rest is counted as rejected."""
        found = self._apply(function, *measured)
        used = [nis for nis in found if nis < gate]
        self.rejected += len(found) - len(used)
        return used

    def _apply(self, function: CompiledFunction, *measured: float) -> list[float]:
        """Evaluate one step from the present state into the next; its normalised innovations squared."""
        mean, covariance, yaw_rate, u, _ = function.arguments
        mean[:], covariance[:], yaw_rate[0], u[:] = self.mean, self.covariance, self.yaw_rate, measured
        function.evaluate()
        mean, covariance, yaw_rate, nis = function.results
        self.mean, self.covariance, self.yaw_rate = mean.copy(), covariance.copy(), float(yaw_rate[0])
        found: list[float] = nis.tolist()
        return found

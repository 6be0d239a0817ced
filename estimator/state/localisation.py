"""From vehicle states to estimates: alignment, gravity from the track map, standstill, recovery.

The filter starts at the first valid position fix, heading along the track there, with a wide uncertainty that
the first metres of motion remove. If fixes keep being refused while the car drives, the estimate is invalid and goes on
without them: what a receiver says after it has jumped is no place to start from at speed. Standing still, or before the
first metres have shown the heading, the filter starts again on the course made good between them.
"""

from __future__ import annotations

from collections import deque
from math import cos, hypot, sin

import numpy as np

from estimator.state.filter_steps import BIAS_YAW_RATE, STATES, VX, VY, YAW
from estimator.state.state_filter import Imu, StateFilter, course
from hil_gateway.bus.messages import Estimate, Lacks, VehicleState
from hil_gateway.car.vehicle import GRAVITY, Vehicle
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.track import Track

MAX_GAP_S = 0.2
"""longest gap between states that is bridged by one prediction"""
LOST_AFTER_FIXES = 10
"""refused fixes in a row after which the filter starts again"""
ALIGNED_AFTER_FIXES = 10
"""fixes taken in while moving (0.5 s) after which the heading is known, and fixes that no longer fit are wrong"""
STANDSTILL_SPEED = 0.15
RESTART_SPEED = 2.0
"""m/s; faster, a filter that has lost its fixes does not start again on them"""
MAX_POSITION_STD = 2.0
"""m, beyond which the estimate calls itself invalid"""
COURSE_DISTANCE = 2.0
"""m between two fixes for their direction to be a heading"""


class Localisation:
    """State filter with the life cycle around it; `step` once a vehicle state, in order."""

    def __init__(self, vehicle: Vehicle, track: Track) -> None:
        self.filter = StateFilter(vehicle)
        self._track = track
        self.track_position = 0.0
        self._started = False
        self._stamp_ns: int | None = None
        self._position_seq: int | None = None
        self._refused = 0
        self._aligned = 0
        """fixes taken in while moving since the start: before some of them the heading is only the track's"""
        self._lost = False
        """fixes were refused in a row: nothing is valid until the filter has started again"""
        self._fixes: deque[tuple[float, float]] = deque(maxlen=LOST_AFTER_FIXES)

    def step(self, state: VehicleState, seq: int) -> Estimate:
        """Estimate at the time of `state`; one with the stamp of the last (nothing new arrived) changes nothing."""
        if state.stamp_ns == self._stamp_ns:
            return self._estimate(state, seq)
        fix = self._new_fix(state)
        if self._started and not (_fresh(state, "imu") and self._predict(state)):
            self._started = False
        if self._started:
            self._update(state, fix)
        elif fix is not None and state.valid:
            self._start(state, *fix)
        self._stamp_ns = state.stamp_ns
        return self._estimate(state, seq)

    @property
    def motion_covariance(self) -> Array:
        """Covariance of vx, vy, yaw_rate, shape (3, 3)."""
        P: Array = self.filter.covariance.take(_MOTION) * _SIGNS
        P[2, 2] += self.filter.noise.yaw_rate**2
        return P

    def _new_fix(self, state: VehicleState) -> tuple[float, float] | None:
        """Position of `state` if it arrived since the last one and is near the track."""
        if state.position_seq in (0, self._position_seq):
            return None
        self._position_seq = state.position_seq
        fix = (state.position_x, state.position_y)
        if not self._track.near(*fix):
            return None
        self._fixes.append(fix)
        return fix

    def _predict(self, state: VehicleState) -> bool:
        """Prediction to the stamp of `state`; False when the gap is too long to bridge."""
        dt = (state.stamp_ns - (self._stamp_ns or 0)) / NS_PER_S
        if not 0.0 < dt <= MAX_GAP_S:
            return False
        self.filter.predict(self._imu(state), dt)
        return True

    def _update(self, state: VehicleState, fix: tuple[float, float] | None) -> None:
        f = self.filter
        front = 0.5 * (state.wheel_speed_fl + state.wheel_speed_fr)
        rear = 0.5 * (state.wheel_speed_rl + state.wheel_speed_rr)
        if max(front, rear) < STANDSTILL_SPEED and abs(f.mean[VX]) < 1.0:
            f.update_standstill(self._imu(state))
        elif _fresh(state, "wheel_speeds"):
            f.update_wheel_speeds(front, rear, state.steer, state.drive)
            f.update_rear_slip(f.specific_force(state.ax, state.ay)[1])
        if fix is not None:
            accepted = f.update_position(*fix) is not None
            self._refused = 0 if accepted else self._refused + 1
            self._aligned += accepted and not _slow(state)
        self._lost = self._lost or self._refused >= LOST_AFTER_FIXES
        if not f.healthy or (self._lost and (_slow(state) or self._aligned < ALIGNED_AFTER_FIXES)):
            self._restart(state)

    def _start(self, state: VehicleState, x: float, y: float) -> None:
        """Align with the track at the first fix; the wheels give the speed."""
        self.track_position, _ = self._track.project(x, y)
        speed = 0.5 * (state.wheel_speed_fl + state.wheel_speed_fr)
        self.filter.initialise(x, y, float(self._track.at(self.track_position).heading), speed)
        self._started, self._refused, self._lost, self._aligned = True, 0, False, 0

    def _restart(self, state: VehicleState) -> None:
        """Begin again from the recent fixes: their course if the car has moved, else the track's direction."""
        (x0, y0), (x, y) = self._fixes[0], self._fixes[-1]
        self._start(state, x, y)
        if hypot(x - x0, y - y0) > COURSE_DISTANCE:
            speed = 0.5 * (state.wheel_speed_fl + state.wheel_speed_fr)
            self.filter.initialise(x, y, course(x0, y0, x, y), speed)

    def _imu(self, state: VehicleState) -> Imu:
        """IMU sample with gravity along the body from grade and bank of the declared track."""
        m, track = self.filter.mean, self._track
        self.track_position, _ = track.project(float(m[0]), float(m[1]), self.track_position)
        i = int(self.track_position / track.length * len(track.s)) % len(track.s)
        uphill, left_up = sin(float(track.grade[i])), sin(float(track.bank[i]))
        across = float(m[YAW]) - float(track.heading[i])
        c, s = cos(across), sin(across)
        return Imu(
            state.ax, state.ay, state.yaw_rate,
            -GRAVITY * (c * uphill + s * left_up), -GRAVITY * (c * left_up - s * uphill),
        )  # fmt: skip

    def _estimate(self, state: VehicleState, seq: int) -> Estimate:
        f = self.filter
        x, y, yaw, vx, vy, _, _, br, *_ = f.mean.tolist()
        fx, fy = f.specific_force(state.ax, state.ay)
        std = f.std().tolist()
        lacks = self._lacks(max(std[0], std[1]))
        return Estimate(
            stamp_ns=state.stamp_ns, seq=seq, state_stamp_ns=state.stamp_ns, valid=state.valid and not lacks,
            x=x, y=y, yaw=yaw, vx=vx, vy=vy, yaw_rate=f.yaw_rate,
            bias_ax=state.ax - fx, bias_ay=state.ay - fy, bias_yaw_rate=br,
            std=(*std[:5], f.yaw_rate_std, *std[5:8]),
            steer=state.steer, drive=state.drive, innovations_rejected=f.rejected, lacks=lacks,
        )  # fmt: skip

    def _lacks(self, position_std: float) -> Lacks:
        if not self._started:
            return "start"
        return "position" if self._lost or position_std >= MAX_POSITION_STD else ""


def _slow(state: VehicleState) -> bool:
    """Whether the car moves no faster than someone pushes it."""
    front = 0.5 * (state.wheel_speed_fl + state.wheel_speed_fr)
    return max(front, 0.5 * (state.wheel_speed_rl + state.wheel_speed_rr)) < RESTART_SPEED


def _fresh(state: VehicleState, source: str) -> bool:
    """Whether a source is alive, as the gateway judges it."""
    health = state.sources.get(source)
    return health is None or health.valid


_MOTION = np.array([[len(STATES) * i + j for j in (VX, VY, BIAS_YAW_RATE)] for i in (VX, VY, BIAS_YAW_RATE)])
"""where they are in the flattened covariance"""
_SIGNS = np.outer([1.0, 1.0, -1.0], [1.0, 1.0, -1.0])
"""the yaw rate falls as its bias grows"""

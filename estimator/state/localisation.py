"""From vehicle states to estimates: alignment, gravity from the track map, standstill, gaps, recovery.

The filter starts at the first valid position fix. Where the car points a receiver may say; else it is not known before
the car has moved by some metres (`alignment.py`); what is missing meanwhile is said in `lacks`, and the heading given
is the track's. A standing car does not turn. A sample or some that are missing are bridged by prediction, ever less
certain. If fixes keep being refused while the car drives, the estimate is invalid and goes on without them: what a
receiver says after it has jumped is no place to start from at speed. At walking pace the filter goes on from them.
"""

from __future__ import annotations

from math import cos, hypot, sin

import numpy as np

from estimator.state.alignment import UNKNOWN_STD, Alignment
from estimator.state.filter_steps import BANK_SHARE, BIAS_AX, BIAS_YAW_RATE, GRADE_SHARE, STATES, VX, VY, YAW, X, Y
from estimator.state.state_filter import SEEN, ImuReading, StateFilter, Unseen
from hil_gateway.bus.delivered import Delivered
from hil_gateway.bus.messages import Agreement, Estimate, Heading, Lacks, VehicleState
from hil_gateway.car.car import Car, Receiver
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.gateway.perceive.road_speed import rests
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.track.track import Track

LATE_S = 0.025
"""s between two states, beyond which one is missing"""
LONGEST_GAP_S = 1.0
"""s without a state that are bridged by one prediction"""
LONGEST_REST_S = 10.0
"""the same of a car that stands before and after: nobody turns one round and brings it back within it"""
ANYTHING_S = 0.3
"""s within which a car goes from any force to any other, and"""
ANYTHING = Unseen(accel=15.0, yaw_rate=0.5)
"""how much that is: half of what tyres and downforce give to either side"""
LOST_AFTER_FIXES = 10
"""refused fixes in a row after which the place is not known"""
JUMP = 2.0
"""m between a standing car and its fixes: more than a receiver corrects itself by, it has been carried away"""
RANGE = 200.0, 200.0, 20.0
"""m/s2, m/s2, rad/s: what no inertial unit in a car reads is no sample of one"""
QUIET = 5.0
"""standard deviations of the gyro within which a standing car does not turn"""
WALKING_SPEED = 2.0
"""m/s; faster, a filter that has lost its fixes does not start again on them"""
FORWARDS_SPEED = 5.0
"""m/s: faster, a car is driving, and forwards"""
MAX_POSITION_STD = 2.0
"""m, beyond which the place is not known"""
MAX_YAW_STD = 0.03
"""rad, beyond which the heading is not known: at walking pace a plan is a car's width off after 60 m"""
GRAVITY_STD = 3.0
"""m/s2 along the body where it is not known which way it points: banks of 20 degrees"""


class Localisation:
    """State filter with the life cycle around it; `step` once a vehicle state, in order."""

    def __init__(self, car: Car, track: Track, placing: Receiver | None = None) -> None:
        """`placing`: as `StateFilter`."""
        self.filter = StateFilter(car, placing)
        self._track = track
        self._road: tuple[list[float], ...] = (track.grade.tolist(), track.bank.tolist(), track.heading.tolist())
        self.track_position = 0.0
        self._started = self._resting = False
        self._alignment: Alignment | None = None
        """while the heading is not known"""
        self._stamp_ns: int | None = None
        self._position_seq: int | None = None
        self._pointed_by = ""
        """receiver of the newest heading"""
        self._refused = self._bridged = 0
        self._read = 0.0, 0.0, 0.0
        """last good sample of the inertial unit: ax, ay, yaw rate"""
        self._unseen_s = 0.0
        """since the last good sample of the inertial unit"""
        self._lost = False
        """fixes were refused in a row: nothing is valid until the car is slow"""

    def step(
        self, state: VehicleState, seq: int, delivered: Delivered | None = None, ours: Agreement | None = None
    ) -> Estimate:
        """Estimate at the time of `state`; one that is no newer than the last changes nothing. `delivered` and `ours`
        (track and car) are passed on with it."""
        dt = self._elapsed(state)
        if dt > 0.0:
            self._stamp_ns = state.stamp_ns
            fix = self._new_fix(state)
            if self._started:
                self._predict(state, dt)
            if self._started:
                self._update(state, fix)
            elif fix is not None and state.valid:
                self._start(state, *fix)
        return self._estimate(state, seq, delivered, ours)

    @property
    def motion_covariance(self) -> Array:
        """Covariance of vx, vy, yaw_rate, shape (3, 3)."""
        P: Array = self.filter.covariance.take(_MOTION) * _SIGNS
        P[2, 2] += self.filter.car.yaw_rate**2
        return P

    def _elapsed(self, state: VehicleState) -> float:
        """Seconds since the last state; infinite for the first, and the first by another clock."""
        if self._stamp_ns is None:
            return float("inf")
        dt = (state.stamp_ns - self._stamp_ns) / NS_PER_S
        return dt if dt > -LONGEST_GAP_S else float("inf")

    def _new_fix(self, state: VehicleState) -> tuple[float, float] | None:
        """Position of `state` if it arrived since the last one and is near the track."""
        if state.position_seq in (0, self._position_seq):
            return None
        self._position_seq = state.position_seq
        fix = (state.position_x, state.position_y)
        return fix if self._track.near(*fix) else None

    def _start(self, state: VehicleState, x: float, y: float) -> None:
        """Begin at a fix: with what was known before of a car that has stood since, else without a heading."""
        self.track_position, _ = self._track.project(x, y)
        self._started, self._lost, self._refused = True, False, 0
        known = state.stood
        if known is not None and rests(state) and hypot(known.x - x, known.y - y) < JUMP:
            self._resume(known, x, y)
        else:
            self._begin(state, x, y)

    def _resume(self, known: Estimate, x: float, y: float) -> None:
        """Go on standing where an estimator before this one has left off."""
        _, _, yaw, *_, ax, ay, rate = known.std
        biases = {"bias_ax_std": ax, "bias_ay_std": ay, "bias_yaw_rate_std": rate}
        self.filter.initialise(x, y, known.yaw, yaw_std=yaw, **biases)
        self.filter.mean[BIAS_AX : BIAS_YAW_RATE + 1] = known.bias_ax, known.bias_ay, known.bias_yaw_rate
        self._alignment = None

    def _begin(self, state: VehicleState, x: float, y: float) -> None:
        """The wheels give the speed, its direction only of a car that drives; the track's direction is a guess."""
        yaw, speed = float(self._track.at(self.track_position).heading), _axle_speeds(state)[0]
        driving, std = speed > FORWARDS_SPEED, self.filter.noise.initial_speed
        vx, vx_std = (speed, std) if driving else (0.0, std + speed)
        tilt = {"bias_ax_std": GRAVITY_STD, "bias_ay_std": GRAVITY_STD}
        self.filter.initialise(x, y, yaw, vx, yaw_std=0.0, vx_std=vx_std, **tilt)
        self._alignment = Alignment(x, y)

    def _predict(self, state: VehicleState, dt: float) -> None:
        """Prediction to the stamp of `state`, over what is missing too; a gap too long to bridge ends the filter."""
        f, (x, y) = self.filter, self.filter.mean[: Y + 1].tolist()
        reads = state.ax, state.ay, state.yaw_rate
        good = all(abs(value) < most for value, most in zip(reads, RANGE, strict=True))
        self._read = reads if good else self._read
        seen = good and _fresh(state, "imu") and dt < LATE_S
        self._unseen_s = 0.0 if seen else self._unseen_s + dt
        self._bridged += not seen
        self._resting = self._rests(state)
        if dt > (LONGEST_REST_S if self._resting else LONGEST_GAP_S):
            self._started = False
            return
        f.predict(self._imu(), dt, self._unseen(), moves=not self._resting)
        if self._alignment is not None:
            self._alignment.carry(float(f.mean[X]) - x, float(f.mean[Y]) - y, dt)
            f.mean[[X, Y]] = x, y

    def _unseen(self) -> Unseen:
        share = min(self._unseen_s / ANYTHING_S, 1.0)
        return Unseen(share * ANYTHING.accel, share * ANYTHING.yaw_rate) if share else SEEN

    def _rests(self, state: VehicleState) -> bool:
        """Whether the car stands: its wheels do, it was as slow before, and the gyro shows no more than its bias."""
        f, stand = self.filter, rests(state) and _fresh(state, "wheel_speeds")
        gyro = abs(self._read[2] - float(f.mean[BIAS_YAW_RATE]))
        return stand and abs(f.mean[VX]) < 1.0 and gyro < QUIET * f.yaw_rate_std

    def _update(self, state: VehicleState, fix: tuple[float, float] | None) -> None:
        f = self.filter
        if self._resting and not self._unseen_s:
            f.update_standstill(self._imu())
        if _fresh(state, "wheel_speeds"):
            f.update_wheel_speeds(*_axle_speeds(state), state.steer, state.drive)
            f.update_rear_slip(f.specific_force(*self._read[:2])[1])
        if state.heading is not None:
            self._point(state.heading, state.receiver)
        if fix is not None and self._alignment is not None:
            self._align(*fix, self._alignment)
        elif fix is not None:
            self._take(state, *fix)
        if not f.healthy:
            f.initialise(0.0, 0.0, 0.0)
            self._started = False

    def _point(self, heading: Heading, receiver: str) -> None:
        """A receiver's heading."""
        f = self.filter
        if receiver != self._pointed_by:
            f.change_receiver()
            self._pointed_by = receiver
        if self._alignment is not None:
            self._alignment = None
            f.align(heading.yaw, UNKNOWN_STD, *self._gravity(float(f.mean[X]), float(f.mean[Y]), heading.yaw))
        f.update_heading(heading.yaw, heading.std)

    def _align(self, x: float, y: float, alignment: Alignment) -> None:
        """A fix of a car whose heading is not known."""
        if self._resting:
            alignment.stand(x, y)
            self.filter.place(alignment.x, alignment.y)
            return
        self.filter.place(x, y)
        if (found := alignment.go(x, y, self.filter)) is not None:
            self._alignment = None
            yaw = float(self.filter.mean[YAW]) + found[0]
            self.filter.align(yaw, found[1], *self._gravity(x, y, yaw))

    def _take(self, state: VehicleState, x: float, y: float) -> None:
        """A fix of a car whose heading is known."""
        f, ago_s = self.filter, (state.stamp_ns - state.fix_ns) / NS_PER_S
        yaw, vx, vy = f.mean[YAW : VY + 1].tolist()
        x, y = x + ago_s * (vx * cos(yaw) - vy * sin(yaw)), y + ago_s * (vx * sin(yaw) + vy * cos(yaw))
        accepted = f.update_position(x, y) is not None
        self._refused = 0 if accepted else self._refused + 1
        self._lost = self._lost or self._refused >= LOST_AFTER_FIXES
        if self._lost and max(_axle_speeds(state)) < WALKING_SPEED:
            jump = hypot(*(f.mean[:2] - (x, y)))
            f.place(x, y)
            self._lost, self._refused, self._started = False, 0, jump < JUMP

    def _imu(self) -> ImuReading:
        """IMU sample with gravity along the body, which passes for biases while the heading is not known."""
        x, y, yaw = self.filter.mean[: YAW + 1].tolist()
        gravity = self._gravity(x, y, yaw) if self._alignment is None else (0.0, 0.0)
        return ImuReading(*self._read, *gravity)

    def _gravity(self, x: float, y: float, yaw: float) -> tuple[float, float]:
        """Along the axes of the body from grade and bank of the declared track, m/s2."""
        track = self._track
        self.track_position, _ = track.project(x, y, self.track_position)
        grades, banks, headings = self._road
        i = int(self.track_position / track.length * len(grades)) % len(grades)
        uphill, left_up = sin(grades[i]), sin(banks[i])
        across = yaw - headings[i]
        c, s = cos(across), sin(across)
        return -GRAVITY * (c * uphill + s * left_up), -GRAVITY * (c * left_up - s * uphill)

    def _estimate(self, state: VehicleState, seq: int, delivered: Delivered | None, ours: Agreement | None) -> Estimate:
        f = self.filter
        x, y, yaw, vx, vy, _, _, br, *_ = f.mean.tolist()
        ax, ay, _ = self._read
        fx, fy = f.specific_force(ax, ay)
        std = f.std().tolist()
        if self._alignment is not None:
            std[YAW] = UNKNOWN_STD
        lacks = self._lacks(max(std[0], std[1]), std[YAW])
        return Estimate(
            stamp_ns=state.stamp_ns, seq=seq, state_stamp_ns=state.stamp_ns, valid=state.valid and not lacks,
            x=x, y=y, yaw=yaw, vx=vx, vy=vy, yaw_rate=f.yaw_rate,
            bias_ax=ax - fx, bias_ay=ay - fy, bias_yaw_rate=br,
            std=(*std[:5], f.yaw_rate_std, *std[5:8]),
            grade_share=float(f.mean[GRADE_SHARE]), bank_share=float(f.mean[BANK_SHARE]),
            steer=state.steer, steer_late=state.steer_late, drive=state.drive, innovations_rejected=f.rejected,
            delivered=delivered, lacks=lacks, bridged=self._bridged, agreement=ours,
        )  # fmt: skip

    def _lacks(self, position_std: float, yaw_std: float) -> Lacks:
        if not self._started:
            return "start"
        if self._lost or position_std >= MAX_POSITION_STD:
            return "position"
        return "heading" if yaw_std >= MAX_YAW_STD else ""


def _axle_speeds(state: VehicleState) -> tuple[float, float]:
    """Mean of the front and of the rear wheels, m/s."""
    front = 0.5 * (state.wheel_speed_fl + state.wheel_speed_fr)
    return front, 0.5 * (state.wheel_speed_rl + state.wheel_speed_rr)


def _fresh(state: VehicleState, source: str) -> bool:
    """Whether a source is alive, as the gateway judges it."""
    health = state.sources.get(source)
    return health is None or health.valid


_MOTION = np.array([[len(STATES) * i + j for j in (VX, VY, BIAS_YAW_RATE)] for i in (VX, VY, BIAS_YAW_RATE)])
"""where they are in the flattened covariance"""
_SIGNS = np.outer([1.0, 1.0, -1.0], [1.0, 1.0, -1.0])
"""the yaw rate falls as its bias grows"""

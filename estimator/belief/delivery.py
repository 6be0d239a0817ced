"""What tyres and brakes deliver now of the force the model in use expects of them: a wet road, a flat tyre, hot brakes.

The belief takes in over seconds what lasts; this looks at the last tenth of a second, by least squares through the
origin of the measured force on the expected one; of the brakes, which may be late, on the least that was expected for a
while. Measured is what the model expects plus what is left of specific force and yaw acceleration, by Eq. (1) turned
round: the force of an axle across, and that of both along while braking.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import casadi as ca
import numpy as np

from estimator.belief.tyre_belief import BeliefSettings, Sample, plausible
from estimator.model.measurement import compiled_for, of_any_car
from estimator.model.single_track import AUXILIARY, SIGNALS, SingleTrack, Terms
from hil_gateway.bus.delivered import Delivered
from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.arrays import Array
from hil_gateway.settings.gateway import PERIOD_S

STEER = SIGNALS.index("steer")
WINDOW = 10
"""samples, 0.1 s: longer, a car at 60 m/s is out of the bend before it is known; shorter, noise of the yaw
acceleration is several percent of an axle's force"""
TELLING = 0.5
"""share of its peak an axle is expected to bear, at least: errors of small forces are large shares"""
BRAKING = 0.5
"""of the weight, expected of the brakes at least, as `TELLING`: half of a stop at 1 g"""
LATE = 15
"""samples, 0.15 s, by which brakes may act later than their pressures are reported: what a late force lacks where a
stop begins is not lost, and asked for again it comes on top"""
ROLLING = 0.06
"""slip of braked wheels up to which their tyres hold what the brakes give: half of the slip at the peak"""
LOCKING = 0.12
"""slip beyond the peak of the tyres along the wheel: what they give there, both axles together, is all there is"""
CONFIRMED = 3
"""samples on end beyond it before wheels are said to lock: one is noise"""


def wheel_slips(state: VehicleState, vx: float) -> tuple[float, float]:
    """Slip of front and rear wheels against the road, 1 at standstill of the wheels; `vx` m/s."""
    front = 0.5 * (state.wheel_speed_fl + state.wheel_speed_fr)
    rear = 0.5 * (state.wheel_speed_rl + state.wheel_speed_rr)
    return 1.0 - front / max(vx, BeliefSettings.min_speed), 1.0 - rear / max(vx, BeliefSettings.min_speed)


class _Row(NamedTuple):
    """One sample: of front and rear axle and of the brakes, N, what is expected, 0 where that does not tell, and what
    is measured; the share of both axles' peaks that is measured; whether wheels roll, and which lock."""

    expected: tuple[float, float, float]
    measured: tuple[float, float, float]
    whole: float
    rolls: bool
    locking: tuple[bool, bool]


class Delivery:
    """`push` every belief sample; `now` says what the last `WINDOW` of them tell."""

    def __init__(self, model: SingleTrack) -> None:
        self._vehicle = model.vehicle
        self._function = compiled_for(model.vehicle, _expected(model))
        self._rows: deque[_Row] = deque(maxlen=WINDOW)
        self._along: deque[float] = deque(maxlen=LATE + 1)
        """force that is expected of the brakes, N <= 0"""
        self._steered: deque[float] = deque(maxlen=LATE + 1)
        """road-wheel angles as reported, rad"""

    def clear(self) -> None:
        """Samples are missing."""
        self._rows.clear()
        self._along.clear()
        self._steered.clear()

    def push(self, sample: Sample, theta: Array, slips: tuple[float, float], steer_late: float = 0.0) -> None:
        """Take in one sample of kind `imu_yaw` with the tyre parameters now believed; `slips` as `wheel_slips`; the
        road wheels follow the reported angle `steer_late` s later."""
        if sample.signals[0] < BeliefSettings.min_speed or not plausible(sample):
            self.clear()
            return
        signals, aux, tyres, phi, _ = self._function.arguments
        signals[:], aux[:], tyres[:], phi[:] = sample.signals, sample.aux, theta, sample.phi
        self._steered.append(float(sample.signals[STEER]))
        signals[STEER] = self._acting(steer_late)
        self._function.evaluate()
        ax, ay, yaw_acc, front, rear, along, *peaks = self._function.results[0].tolist()
        z = sample.z.tolist()
        missing = self._missing(z[0] - ax, z[1] - ay, z[2] - yaw_acc)
        measured = front + missing[0], rear + missing[1], along + missing[2]
        whole = math.hypot(measured[0] + measured[1], measured[2]) / sum(peaks)
        self._along.append(_telling(along, BRAKING * GRAVITY * self._vehicle.mass))
        front, rear = _telling(front, TELLING * peaks[0]), _telling(rear, TELLING * peaks[1])
        locking = slips[0] > LOCKING, slips[1] > LOCKING
        self._rows.append(_Row((front, rear, self._due()), measured, whole, max(slips) < ROLLING, locking))

    def _missing(self, ax: float, ay: float, yaw_acc: float) -> tuple[float, float, float]:
        """Forces, N, of front and rear axle across and of both along that such a rest of the measurement comes to."""
        v = self._vehicle
        front = (v.mass * v.lr * ay + v.yaw_inertia * yaw_acc) / v.wheelbase
        return front, v.mass * ay - front, v.mass * ax

    def _acting(self, late_s: float) -> float:
        """Road-wheel angle that was reported so long ago, rad."""
        ago = min(late_s / PERIOD_S, len(self._steered) - 1.0)
        whole = int(ago)
        newer, older = self._steered[-1 - whole], self._steered[-min(2 + whole, len(self._steered))]
        return newer + (ago - whole) * (older - newer)

    def _due(self) -> float:
        """Least braking force, N <= 0, expected within the last `LATE` samples and now; 0 if not known."""
        return max(self._along) if len(self._along) > LATE else 0.0

    def now(self) -> Delivered | None:
        """Shares of the last `WINDOW` samples; None where nothing tells."""
        rows = list(self._rows)
        if len(rows) < WINDOW:
            return None
        if any(True in row.locking for row in rows):
            held = float(np.mean([row.whole for row in rows]))  # no slip angle is known well where wheels give no speed
            front_locks, rear_locks = (all(row.locking[axle] for row in rows[-CONFIRMED:]) for axle in range(2))
            return Delivered(front=held, rear=held, brakes=None, locking=(front_locks, rear_locks))
        front, rear, brakes = (_share(rows, i) for i in range(3))
        brakes = brakes if brakes is not None and all(row.rolls for row in rows) else None
        return None if front is rear is brakes is None else Delivered(front=front, rear=rear, brakes=brakes)


def _telling(force: float, least: float) -> float:
    return force if abs(force) > least else 0.0


def _share(rows: list[_Row], i: int) -> float | None:
    """Of the i-th force; None where one of the rows does not tell."""
    expected = [row.expected[i] for row in rows]
    if 0.0 in expected:
        return None
    given = sum([force * row.measured[i] for force, row in zip(expected, rows, strict=True)])
    return given / max(sum([force * force for force in expected]), 1.0)


def _expected(model: SingleTrack) -> ca.Function:
    """(signals, aux, theta, phi, car) to a_x, a_y and yaw acceleration; F_yf, F_yr and, braking, F_x of both axles;
    peaks of front and rear axle, all N."""
    model, vehicle = of_any_car(model)
    signals, aux = ca.SX.sym("signals", len(SIGNALS)), ca.SX.sym("aux", len(AUXILIARY))
    theta, phi = ca.SX.sym("theta", len(model.tyre_table)), ca.SX.sym("phi", len(model.effect_table))
    named = dict(zip(SIGNALS, ca.vertsplit(signals), strict=True))
    auxiliary = dict(zip(AUXILIARY, ca.vertsplit(aux), strict=True))
    effects = ca.vertsplit(phi) if phi.numel() else []
    t = model.evaluate(Terms(model.vehicle, **named, aux=auxiliary), ca.vertsplit(theta), effects)
    forces = ca.vertcat(t.fy_f, t.fy_r, ca.fmin(t.fx_f + t.fx_r, 0.0))
    rows = ca.vertcat(t.imu_ax, t.imu_ay, t.yaw_acc, forces, t.peak_f, t.peak_r)
    return ca.Function("expected", [signals, aux, theta, phi, vehicle], [ca.densify(rows)])

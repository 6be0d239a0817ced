"""Gain of the IMU: what it shows of a motion that two others both say, against what a sound one shows.

With the yaw rate w that steering and front wheels both say at least, to the same side, a gyro of gain k shows k w. Of
two gains, 1 (sound) and 0 (it hangs), the logarithm of the likelihood ratio grows with w (w - 2 g) (A. Wald,
Sequential Analysis, 1947, with the noise left in the unit of the bound); added up from its last zero on (E. S. Page,
Biometrika 41, 1954) it finds a gyro that hangs, and three times as fast one of the other sign. In a bend that takes a
period, on a straight it takes the beginning of the next bend: the heading is some hundredths of a radian wrong by then.
The same with the lateral specific force over the speed finds accelerometers, beyond what side slip that builds up
makes, and so do engine or brakes and the wheels' change of speed with the longitudinal one. There only the sign counts,
with -2 w a, as in a stop everywhere: wheels that slip say more than the car does, to the same side.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from hil_gateway.bus.messages import VehicleState
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.gyro_repair import GyroRepair
from hil_gateway.gateway.perceive.monitors.sensors import FORCE as SIDE_SLIP
from hil_gateway.gateway.perceive.monitors.still import UNEVEN
from hil_gateway.gateway.settings import PERIOD_S

JUDGED_FROM = 15.0
"""m/s: slower, gravity across the car and noise of the wheel speeds are large beside v r"""
TURN, FORCE, PUSH = 3e-4, 6e-4, 0.6
"""rad^2/s, rad^2/s and m^2/s^3: 51 min of healthy drives of 24 random cars come to 1e-6, nothing and 0.105. Turns below
`STRAIGHT` say nothing: with them a steering zero came to 3e-4"""
TOLD = TURN / 3.0
"""rad^2/s said of a turn with which a gyro of the other sign is found: enough to tell the sign of any"""
STRAIGHT = 0.02
"""rad/s that say nothing of a turn: at 80 m/s a steering zero of 0.002 rad and front radii that differ by 0.04 %"""
RIGHT = 0.5
"""gain from which a reading is right, and of the other sign below its negative: nearer to that than to none"""
FILTER_S = 0.04
"""time constant of gyro and wheels, s: noise of the wheel speeds"""
GAINED = 16
"""periods over which wheels tell an acceleration: noise of 0.3 % at 80 m/s is 2 m/s2; the others are as late"""
PEDALS_S = 0.03
"""s after which the car follows brakes and engine"""


@dataclass(frozen=True, slots=True)
class Others:
    """What the IMU is held against: yaw rates that steering and front wheels mean, rad/s (the engine slips inner rear
    wheels; inner front ones slip under the brakes), and the speed by the wheels, m/s."""

    steered: float
    wheels: float
    speed: float


class _Reading:
    """Evidence against one reading, and its gain."""

    def __init__(self) -> None:
        self.evidence = self._shown = self._said = 0.0

    def add(self, said: float, shown: float, sign_alone: bool, keeps: bool) -> None:
        """A period in which others say `said`, and the reading shows `shown` of it. Its gain is that since there was
        no evidence, or where it `keeps` on, since it was last forgotten."""
        more = said * ((0.0 if sign_alone else said) - 2.0 * shown)
        self.evidence = max(self.evidence + PERIOD_S * more, 0.0)
        if self.evidence <= 0.0 and not keeps:
            self.forget()
        self._shown, self._said = self._shown + PERIOD_S * shown * said, self._said + PERIOD_S * said**2

    def forget(self) -> None:
        """Nothing has been said yet."""
        self.evidence = self._shown = self._said = 0.0

    def sign(self, least: float) -> float:
        """1 where it has been right, -1 where it has shown the other sign, 0 where less than `least` has been said, or
        it has shown something else."""
        if self._said < least or abs(self._shown) < RIGHT * self._said:
            return 0.0
        return 1.0 if self._shown > 0.0 else -1.0


class _Along:
    """Acceleration that engine or brakes and the wheels both say, and the one that is felt, equally late."""

    def __init__(self, config: Config) -> None:
        car = config.vehicle
        self._per_drive = config.powertrain.force_per_drive / car.mass
        self._drag = 0.5 * car.air_density * car.drag_area / car.mass
        self._speeds: deque[float] = deque(maxlen=GAINED + 1)
        self._pushed = self._felt = 0.0

    def step(self, state: VehicleState, speed: float) -> tuple[float, float]:
        """m/s2; the first is 0 where they differ in sign or the wheels have not told yet."""
        half = 0.5 * GAINED * PERIOD_S
        pushed = self._per_drive * state.drive - self._drag * speed**2
        self._pushed += PERIOD_S / (PERIOD_S + half + PEDALS_S) * (pushed - self._pushed)
        self._felt += PERIOD_S / (PERIOD_S + half) * (state.ax - self._felt)
        self._speeds.append(speed)
        if len(self._speeds) <= GAINED:
            return 0.0, self._felt
        gained = (self._speeds[-1] - self._speeds[0]) / (GAINED * PERIOD_S)
        return _common(self._pushed, gained), self._felt


class GainMonitor:
    """What it has found holds until the car stands."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._turn, self._force, self._push = _Reading(), _Reading(), _Reading()
        self._change = _Reading()
        """the gyro by what has changed since one was found: one that hangs may show what the car happens to do"""
        self._was = (0.0, 0.0)
        """what the steering said of the turn, and the gyro showed, then, rad/s"""
        self._along = _Along(config)
        self._gyro = self._wheels = 0.0
        """yaw rates, filtered, rad/s"""
        self._braking = 0.0
        """deceleration by the brakes that the filtered wheels have slipped for, m/s2"""
        self._per_drive = config.powertrain.force_per_drive / config.vehicle.mass
        self._uneven = UNEVEN / config.vehicle.track_front
        self.found = False
        """whether one of the readings has another gain than a sound one's"""
        self._gyro_found = False
        """whether that is the gyro"""
        self.repair: GyroRepair | None = None
        """what makes the gyro right again, once that is told"""

    def step(self, state: VehicleState, speed: float, ay: float, others: Others | None, stopping: bool) -> None:
        """`ay`: lateral specific force without gravity, m/s2; `others` is None where they or the IMU say nothing."""
        if speed <= 0.0:
            self.found, self.repair = False, None
        if speed < JUDGED_FROM or others is None:
            self._begin(state.yaw_rate)
            return
        turn = self._turned(state, speed, others)
        said, shown = (turn, state.yaw_rate) if self.found else (_beyond(turn, STRAIGHT), self._gyro)
        self._turn.add(said, shown, stopping, self.found)
        self._force.add(_beyond(turn, SIDE_SLIP / speed), ay / speed, stopping, self.found)
        self._push.add(*self._along.step(state, others.speed), sign_alone=True, keeps=self.found)
        if not self.found:
            self._find(others.steered, state.yaw_rate)
            return
        self._change.add(others.steered - self._was[0], state.yaw_rate - self._was[1], stopping, keeps=True)
        if self.repair is None or self.repair.force == 0.0:
            self.repair = self._told() or self.repair

    def _find(self, steered: float, yaw_rate: float) -> None:
        """Whether evidence is enough. What is found is told by what it shows from then on: the filter still keeps what
        a reading showed before it went wrong."""
        self._gyro_found = self._turn.evidence > TURN
        self.found = self._gyro_found or self._force.evidence > FORCE or self._push.evidence > PUSH
        if self.found:
            self._was = steered, yaw_rate
            for reading in (self._turn, self._force, self._change):
                reading.forget()

    def _begin(self, yaw_rate: float) -> None:
        for reading in (self._turn, self._force, self._push, self._change):
            reading.forget()
        self._along = _Along(self._config)
        self._gyro = self._wheels = yaw_rate

    def _turned(self, state: VehicleState, speed: float, others: Others) -> float:
        """Yaw rate that steering and wheels both say, rad/s, after the filters of gyro and wheels; what slip of an
        inner wheel may be is none of it. Of an IMU that is wrong steering alone tells the rest."""
        share = PERIOD_S / (PERIOD_S + FILTER_S)
        self._gyro += share * (state.yaw_rate - self._gyro)
        self._wheels += share * (others.wheels - self._wheels)
        self._braking = max((1.0 - share) * self._braking, -self._per_drive * state.drive)
        slack = self._uneven * speed * self._braking
        return others.steered if self.found else _common(others.steered, _beyond(self._wheels, slack))

    def _told(self) -> GyroRepair | None:
        """By what gyro and lateral force have shown since one was found; a gyro that was it is not right as it is."""
        sign = self._turn.sign(TOLD)
        told = sign == self._change.sign(TOLD) and (sign < 0.0 or (sign > 0.0 and not self._gyro_found))
        return GyroRepair(sign=sign, force=self._force.sign(TOLD)) if told else None


def _beyond(value: float, slack: float) -> float:
    """What is left of it beyond a slack to either side."""
    return math.copysign(max(abs(value) - slack, 0.0), value)


def _common(one: float, other: float) -> float:
    """What both say at least; 0 where they differ in sign."""
    if one * other <= 0.0:
        return 0.0
    return min(one, other, key=abs)

"""Gain of the IMU: what it shows of a turn that steering and front wheels both say, against what a sound one shows.

With the yaw rate w that both say at least, to the same side, a gyro of gain k shows k w. Of two gains, 1 (sound) and 0
(it hangs), the logarithm of the likelihood ratio grows with w (w - 2 g) (A. Wald, Sequential Analysis, 1947, with the
noise left in the unit of the bound); added up from its last zero on (E. S. Page, Biometrika 41, 1954) it finds a
gyro that hangs, and three times as fast one of the other sign. In a bend that takes a period, on a straight it takes
the beginning of the next bend: the heading is some hundredths of a radian wrong by then. The same with the
lateral specific force over the speed finds accelerometers.
"""

from __future__ import annotations

from hil_gateway.gateway.perceive.gyro_repair import GyroRepair
from hil_gateway.gateway.settings import PERIOD_S

JUDGED_FROM = 15.0
"""m/s: slower, gravity across the car and noise of the wheel speeds are large beside v r"""
TURN, FORCE = 3e-4, 6e-4
"""rad^2/s: healthy drives of eight random cars (75 s each) come to 0.5e-4 and 1.7e-4; six and four times as much"""
MIRRORED = -0.5
"""gain of the gyro below which its sign is wrong: nearer to -1 than to 0"""
FILTER_S = 0.04
"""time constant of gyro and wheels, s: noise of the wheel speeds"""


class _Reading:
    """One reading of the IMU."""

    def __init__(self) -> None:
        self.evidence = self._shown = self._turned = 0.0
        """against it, and what it and the car have turned by since there was none, squared: rad^2/s"""

    def add(self, turn: float, shown: float) -> None:
        """A period in which the car turns by `turn` and the reading shows `shown` of it, rad/s."""
        self.evidence = max(self.evidence + PERIOD_S * turn * (turn - 2.0 * shown), 0.0)
        if self.evidence > 0.0:
            self._shown, self._turned = self._shown + shown * turn, self._turned + turn**2
        else:
            self._shown = self._turned = 0.0

    @property
    def gain(self) -> float:
        """Of the reading since there was no evidence against it, by least squares; 1 where there is none."""
        return self._shown / self._turned if self._turned > 0.0 else 1.0


class GainMonitor:
    """What it has found holds until the car stands."""

    def __init__(self) -> None:
        self._turn, self._force = _Reading(), _Reading()
        self._gyro = self._wheels = 0.0
        """yaw rates, filtered, rad/s"""
        self.found = False
        """whether gyro or accelerometer have another gain than a sound one's"""
        self.repair: GyroRepair | None = None
        """what makes the gyro right again: nothing where only the accelerometer is wrong, its sign where that is"""

    def step(self, speed: float, imu: tuple[float, float], others: tuple[float, float] | None) -> None:
        """`imu`: yaw rate, rad/s, and lateral specific force without gravity, m/s2; `others`: yaw rates that steering
        and front wheels mean (the engine slips inner rear ones), rad/s, None where they or the IMU say nothing."""
        if speed <= 0.0:
            self.found, self.repair = False, None
        if speed < JUDGED_FROM or others is None:
            self._turn, self._force = _Reading(), _Reading()
            self._gyro = self._wheels = imu[0]
            return
        share = PERIOD_S / (PERIOD_S + FILTER_S)
        self._gyro += share * (imu[0] - self._gyro)
        self._wheels += share * (others[1] - self._wheels)
        turn = _common(others[0], self._wheels)
        self._turn.add(turn, self._gyro)
        self._force.add(turn, imu[1] / speed)
        if not self.found and max(self._turn.evidence / TURN, self._force.evidence / FORCE) > 1.0:
            self.found, self.repair = True, self._repair()

    def _repair(self) -> GyroRepair | None:
        """By the gains: a gyro without evidence against it is right, and one that shows the other sign is mirrored."""
        force = _sign(self._force)
        sign = _sign(self._turn)
        return GyroRepair(sign=sign, force=force) if sign else None


def _sign(reading: _Reading) -> float:
    """1 of one that is right, -1 of one that is mirrored, 0 of one that shows nothing."""
    if reading.evidence <= 0.0:
        return 1.0
    return -1.0 if reading.gain < MIRRORED else 0.0


def _common(one: float, other: float) -> float:
    """What both say at least; 0 where they differ in sign."""
    if one * other <= 0.0:
        return 0.0
    return min(one, other, key=abs)

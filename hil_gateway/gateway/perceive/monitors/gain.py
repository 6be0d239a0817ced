"""Gain of the IMU: what it shows of a turn that steering and front wheels both say, against what a sound one shows.

With the yaw rate w that both say at least, to the same side, a gyro of gain k shows k w. Of two gains, 1 (sound) and 0
(it hangs), the logarithm of the likelihood ratio grows with w (w - 2 g) (A. Wald, Sequential Analysis, 1947, with the
noise left in the unit of the bound); added up from its last zero on (E. S. Page, Biometrika 41, 1954) it finds a
gyro that hangs, and three times as fast one of the other sign. In a bend that takes a period, on a straight it takes
the beginning of the next bend: the heading is some hundredths of a radian wrong by then. The same with the
lateral specific force over the speed finds accelerometers.
"""

from __future__ import annotations

from hil_gateway.gateway.settings import PERIOD_S

JUDGED_FROM = 15.0
"""m/s: slower, gravity across the car and noise of the wheel speeds are large beside v r"""
TURN, FORCE = 3e-4, 6e-4
"""rad^2/s: healthy drives of eight random cars (75 s each) come to 0.5e-4 and 1.7e-4; six and four times as much"""
FILTER_S = 0.04
"""time constant of gyro and wheels, s: noise of the wheel speeds"""


class GainMonitor:
    """What it has found holds until the car stands."""

    def __init__(self) -> None:
        self._turn = self._force = 0.0
        """evidence against gyro and accelerometer, rad^2/s"""
        self._gyro = self._wheels = 0.0
        """yaw rates, filtered, rad/s"""
        self.found = False
        """whether gyro or accelerometer have another gain than a sound one's"""

    def step(self, speed: float, imu: tuple[float, float], others: tuple[float, float] | None) -> None:
        """`imu`: yaw rate, rad/s, and lateral specific force without gravity, m/s2; `others`: yaw rates that steering
        and front wheels mean (the engine slips inner rear ones), rad/s, None where they or the IMU say nothing."""
        self.found = self.found and speed > 0.0
        if speed < JUDGED_FROM or others is None:
            self._turn = self._force = 0.0
            self._gyro = self._wheels = imu[0]
            return
        share = PERIOD_S / (PERIOD_S + FILTER_S)
        self._gyro += share * (imu[0] - self._gyro)
        self._wheels += share * (others[1] - self._wheels)
        turn = _common(others[0], self._wheels)
        self._turn = _added(self._turn, turn, self._gyro)
        self._force = _added(self._force, turn, imu[1] / speed)
        self.found = self.found or self._turn > TURN or self._force > FORCE


def _added(evidence: float, turn: float, shown: float) -> float:
    """Evidence after a period in which the car turns by `turn` and a reading shows `shown` of it, rad/s."""
    return max(evidence + PERIOD_S * turn * (turn - 2.0 * shown), 0.0)


def _common(one: float, other: float) -> float:
    """What both say at least; 0 where they differ in sign."""
    if one * other <= 0.0:
        return 0.0
    return min(one, other, key=abs)

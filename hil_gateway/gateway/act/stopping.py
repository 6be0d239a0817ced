"""Stopping without the planner: steering that keeps the car on the road, braking within the grip left.

Steering is pure pursuit (Coulter, CMU-RI-TR-92-01): curvature k = 2 sin(alpha) / l towards the point a look-ahead
distance l along the path; alpha is taken from the direction in which the rear axle goes on such a path. Where a gyro
tells how the car turns, the angle is the one with which its axles come to v k in the time by which the steering is
late, from where the car is when it answers (`observer.axles`): so a slide is caught. Else delta = atan(L k + U v^2 k0)
+ K (v k - r) with the yaw rate r, the later the less of it, the understeer U under the brakes and the curvature k0 of
the path. The path is the way along the track with the least lateral force from where the car is when the stop begins,
and as it turns then; without a track the steering is held.
Braking is as hard as configured, and harder where a bend ahead on that path would be entered too fast.
"""

from __future__ import annotations

import math

import numpy as np

from hil_gateway.car.car import Car
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.gateway.act.stop_path import CLEAR, CLEAR_BLIND, Path, way_along
from hil_gateway.gateway.perceive.course import COURSE_WINDOW
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.motion import BRAKED_UNDERSTEER, Motion
from hil_gateway.observer.axles import Axles
from hil_gateway.observer.observer import SLOWEST
from hil_gateway.settings.gateway import PERIOD_S, StopConfig, beside
from hil_gateway.track.track import Track

LOOK_AHEAD_S = 0.4
"""the longer, the wider a car that understeers swings out at 60 m/s; at 0.3 it begins to weave"""
STEADIES = 0.0065
"""K times the time by which steering and yaw rate are late, s2: a car that is answered late weaves. One with more grip
in front than behind turns the faster the faster it turns, at up to 2 1/s at 70 m/s when braking has moved the load
forward: without K it spins. With steering that is 0.1 s late K = 0.03 s just holds such a car, and 0.07 s
one with a flat rear tyre; with 0.14 s it weaves, and with 0.07 s where all reports are 0.1 s late as well"""
FLAT_GRIP = 0.7
"""share of the declared grip with a flat tyre: it bears less than half, and its axle carries half of the car"""
FAR_FROM_WAY = 1.5
"""m off its way at which a stop gets a new one: the tyres have not held, or the pose was wrong"""
ROLLS_OUT = 55.0
"""m/s whose drag slows down a car without brakes; a slower one leaves its way a little to the inside"""


class Stopping:
    """Keeps its path; answers with (steer, drive)."""

    def __init__(self, car: Car, config: StopConfig, track: Track | None) -> None:
        self._car, self._vehicle = car, car.vehicle
        self._config = config
        self._force_per_drive = car.powertrain.force_per_drive
        self._track = track
        self._path: Path | None = None
        self._steer = 0.0
        self.flat = False
        """whether a tyre is flat"""
        self.blind = False
        """whether no fixes hold the pose"""
        self.lateral: float | None = None
        """specific force that the car has or its way needs, m/s2; None where it does not steer: brakes take all"""
        self._brakes = True
        self._clear = CLEAR
        self._asked = 0.0
        """curvature that the steering asks for, 1/m"""

    def start(self, steer: float) -> None:
        """A stop begins; without a path the present angle is held."""
        self._steer, self._path, self._brakes, self._clear = steer, None, True, CLEAR

    def command(
        self, motion: Motion, pose: Pose | None, emergency: bool, axles: Axles | None = None,
        *, steers: bool = True, brakes: bool = True,
    ) -> tuple[float, float]:  # fmt: skip
        """Road-wheel angle (rad) and slip-ratio drive (negative) of this period; `axles` when that angle acts.

        A car that no longer `steers` brakes with all the grip beside the lateral force it has; one whose `brakes` do
        not follow takes the way of a car that rolls out.
        """
        config = self._config
        if self._brakes and not brakes:
            self._brakes, self._path = False, None
        if self.blind and self._clear < CLEAR_BLIND:
            self._clear, self._path = CLEAR_BLIND, None
        if pose is not None and (self._path is None or self._path.distance(pose.x, pose.y) > FAR_FROM_WAY):
            self._path = self._way(pose, motion) or self._path
        wanted = config.emergency_deceleration if emergency else config.controlled_deceleration
        lateral, grip = abs(motion.ay), self._grip_at(motion.speed)
        if self._path is not None and pose is not None:
            self._steer = self._pursue(self._path, pose, motion, axles)
            here = self._path.nearest(pose.x, pose.y)
            for_bends = self._for_bends(self._path, here, motion.speed)
            wanted = max(wanted, for_bends)
            if steers:
                lateral = max(lateral, self._needed(self._path, here, motion.speed, for_bends, grip))
        self.lateral = lateral if steers else None
        left = beside(lateral, grip)
        force = self._vehicle.mass * (min(wanted, left) if steers else left)
        return self._steer, -force / self._force_per_drive

    def _way(self, pose: Pose, motion: Motion) -> Path | None:
        """The way of this stop, which begins as the car turns now; None where there is none."""
        if self._track is None:
            return None
        deceleration = self._config.controlled_deceleration if self._brakes else self._vehicle.drag(ROLLS_OUT)
        return way_along(self._track, self._vehicle.half_width, pose, motion.yaw_rate, deceleration, clear=self._clear)

    def _pursue(self, path: Path, pose: Pose, motion: Motion, axles: Axles | None) -> float:
        late_s = self._car.actuators.steering_late
        if axles is not None:
            pose = pose.onward(late_s * pose.speed, axles.turned)
        curvature, bend = self._curvatures(path, pose, motion, axles)
        self._asked = abs(curvature)
        late_s = motion.late_s + max(late_s, 2.0 * PERIOD_S)  # a period each for command and report
        if axles is not None:
            return axles.steered((motion.speed * curvature - axles.yaw_rate) / late_s)
        too_slow = motion.speed * curvature - motion.yaw_rate
        understeer = BRAKED_UNDERSTEER * motion.understeer * motion.speed**2 * bend
        return math.atan(self._vehicle.wheelbase * curvature + understeer) + STEADIES / late_s * too_slow

    def _curvatures(self, path: Path, pose: Pose, motion: Motion, axles: Axles | None) -> tuple[float, float]:
        """Of the arc to the point ahead, and of the path, 1/m."""
        rear_x = pose.x - self._vehicle.lr * math.cos(pose.yaw)
        rear_y = pose.y - self._vehicle.lr * math.sin(pose.yaw)
        late_s = 0.0 if motion.by_gyro else 0.5 * COURSE_WINDOW * PERIOD_S  # as the heading of fixes is
        look_ahead = (LOOK_AHEAD_S + late_s) * max(pose.speed, SLOWEST)
        behind = path.nearest(rear_x, rear_y)
        (x, y), bend = path.ahead(behind, look_ahead), float(path.curvature[behind])
        angle = math.atan2(y - rear_y, x - rear_x) - pose.yaw - self._rear_goes(motion, axles, bend)
        distance = max(math.hypot(x - rear_x, y - rear_y), LOOK_AHEAD_S * SLOWEST)
        curvature = 2 * math.sin(angle) / distance
        return curvature if motion.by_gyro else self._within_grip(curvature, motion.speed), bend

    def _within_grip(self, curvature: float, speed: float) -> float:
        """As much of it as any tyres hold: more steering turns no car in, and none that slides out."""
        most = self._car.most_grip * self._vehicle.pressed(speed) / max(speed, 1.0) ** 2
        return min(max(curvature, -most), most)

    def _rear_goes(self, motion: Motion, axles: Axles | None, curvature: float) -> float:
        """Angle from where the car points to where its rear axle goes on a path of this curvature, rad.

        Answered to the slip that it has, a car that oversteers weaves. Without a gyro the yaw of the pose is the course
        of the centre of gravity.
        """
        if axles is not None:
            return axles.rear_goes(curvature)
        return 0.0 if motion.by_gyro else -self._vehicle.lr * curvature

    def _for_bends(self, path: Path, here: int, speed: float) -> float:
        """Deceleration after which no bend ahead needs more grip than tyres are sure to have, m/s2.

        v^2 of a bend with curvature k: mu (m g + c v^2) = m k v^2, with the sure grip mu and downforce c.
        """
        grip, lift = (1.0 - self._car.grip_spread) * self._grip, self._vehicle.downforce(1.0) / self._vehicle.mass
        distance = path.s[here + 1 :] - path.s[here]
        allowed = grip * GRAVITY / np.maximum(np.abs(path.curvature[here + 1 :]) - grip * lift, 1e-4)
        needed = (speed**2 - allowed) / (2.0 * np.maximum(distance, speed * LOOK_AHEAD_S))
        return float(needed.max(initial=0.0))

    def _needed(self, path: Path, here: int, speed: float, for_bends: float, grip: float) -> float:
        """Lateral force that the way needs where the car is, and the steering asks for as far as the braking for bends
        ahead leaves it, m/s2.

        Front tyres that are braked past their grip turn the car less: by the force that it has it would seem to need
        none. A car that is beside its way asks for more than the way.
        """
        left = math.sqrt(max(grip**2 - for_bends**2, 0.0))
        return max(abs(float(path.curvature[here])) * speed**2, min(self._asked * speed**2, left))

    def _grip_at(self, speed: float) -> float:
        """Specific force that the tyres make, m/s2."""
        return self._config.grip(self._vehicle, speed) * (FLAT_GRIP if self.flat else 1.0)

    @property
    def _grip(self) -> float:
        """Lateral specific force that the tyres hold, g."""
        return self._config.lateral_grip * (FLAT_GRIP if self.flat else 1.0)

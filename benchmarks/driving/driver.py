"""A scripted driver for experiments on the plant alone: speed profile, preview steering, pedals.

It knows the true car and the true state, which nothing in the loop may. It exists to drive progressively faster
laps for identification and diagnosis experiments, many times faster than the loop does.
"""

from __future__ import annotations

import math

import numpy as np

from hil_gateway.car.actuation import Actuation
from hil_gateway.car.car import load_car
from hil_gateway.car.powertrain import GearChoice
from hil_gateway.car.vehicle import GRAVITY, Vehicle
from hil_gateway.plant.car import Car, Commands
from hil_gateway.process.arrays import Array
from hil_gateway.track.track import Track

LOOK_AHEAD_S = 0.45
LOOK_AHEAD_M = 5.0
SPEED_GAIN = 2.4
"""1/s"""
TOP_SPEED = 80.0
UNDERSTEER = 0.001
"""s2/m, of the realistic car at moderate lateral acceleration"""
YAW_DAMPING = 0.03
"""s, steering against yaw that the path does not ask for"""


def speed_profile(track: Track, car: Car, level: float) -> Array:
    """Speed along the centre line, m/s, shape of `track.s`, using the share `level` of the friction circle.

    Quasi-steady: cornering limit m v^2 |kappa| = level mu (m g + k v^2) with vertical curvature, then forward and
    backward passes under the ellipse that remains.
    """
    p = car.parameters.car
    mu = level * min(p.df, p.dr)
    bend = car.parameters.road.grade * np.gradient(track.grade, track.s)
    denominator = np.abs(track.curvature) - mu * (p.downforce / p.mass + bend)
    limit = np.where(denominator > 1e-6, np.sqrt(mu * GRAVITY / np.maximum(denominator, 1e-6)), TOP_SPEED)
    limit = np.minimum(limit, TOP_SPEED * math.sqrt(level))
    forward = _pass(limit, track, mu, 0.55)
    return _pass(forward[::-1], track, mu, 0.65)[::-1]


def _pass(limit: Array, track: Track, mu: float, share: float) -> Array:
    """Limit the rise of speed along the array to `share` of the friction left by cornering; two laps to be periodic."""
    ds = track.length / len(track.s)
    v = [float(x) for x in limit]
    kappa = (GRAVITY * mu / np.maximum(limit, 1.0) ** 2).tolist()
    for i in range(1, 2 * len(v)):
        before, here = v[(i - 1) % len(v)], i % len(v)
        used = min(1.0, before * before * kappa[(i - 1) % len(v)] / (GRAVITY * mu))
        rise = share * mu * GRAVITY * math.sqrt(1.0 - used * used) + 0.05
        v[here] = min(v[here], math.sqrt(before * before + 2.0 * rise * ds))
    return np.array(v)


class Driver:
    """`__call__` gives the commands for the car as it is now, to be held for 10 ms."""

    def __init__(self, car: Car, vehicle: Vehicle, level: float) -> None:
        self._car, self._vehicle = car, vehicle
        self._track = car.road.track
        train = self._train = load_car().powertrain
        self._actuation = Actuation(vehicle, train)
        self._gears = GearChoice(train, vehicle.wheel_radius)
        self._n = len(self._track.s)
        self.level = 0.0
        self.set_level(level)

    def set_level(self, level: float) -> None:
        """Drive at another share of the grip from now on."""
        if level != self.level:
            self.level = level
            self._speed = speed_profile(self._track, self._car, level).tolist()
            self._grip = level * min(self._car.parameters.car.df, self._car.parameters.car.dr) * GRAVITY

    def __call__(self, now_ns: int) -> Commands:
        car = self._car
        vx = car["vx"]
        steer = self._steer(vx)
        force = self._vehicle.mass * self._acceleration(vx)
        gear = self._gears.step(now_ns, vx, car.output("engine_speed"), car.gear)
        drive = force / self._train.force_per_drive
        a = self._actuation.to_actuators(steer, drive, car.gear or gear, car.output("engine_speed"), gear)
        return Commands(steer, a.accelerator, a.brake_front, a.brake_rear, gear)

    def _index(self, s: float) -> int:
        return int(s / self._track.length * self._n) % self._n

    def _acceleration(self, vx: float) -> float:
        """Follow the profile a little ahead, m/s2; drag and grade are left to the gain."""
        ahead = float(self._speed[self._index(self._car.road.s + 0.25 * vx)])
        used = abs(self._car.output("ay")) / self._grip
        limit = self._grip * math.sqrt(max(0.0, 1.0 - used * used))
        return max(-0.7 * limit - 0.3, min(0.6 * limit + 0.3, SPEED_GAIN * (ahead - vx)))

    def _steer(self, vx: float) -> float:
        """Pure pursuit of the centre line: delta = kappa (L + K v^2) with kappa the arc to the preview point."""
        car = self._car
        ahead = LOOK_AHEAD_M + LOOK_AHEAD_S * max(vx, 0.0)
        point = self._track.at(car.road.s + ahead)
        dx, dy = point.x - car["x"], point.y - car["y"]
        heading = car["yaw"] + math.atan2(car["vy"], max(vx, 5.0))
        across = math.cos(heading) * dy - math.sin(heading) * dx
        kappa = float(2.0 * across / (dx * dx + dy * dy))
        swing = YAW_DAMPING * (kappa * vx - car["yaw_rate"])
        return kappa * (self._vehicle.wheelbase + UNDERSTEER * vx * vx) + swing

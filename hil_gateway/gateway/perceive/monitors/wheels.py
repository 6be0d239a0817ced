"""Wheel speeds against each other, and against what brakes can do to a wheel."""

from __future__ import annotations

from hil_gateway.bus.messages import VehicleState
from hil_gateway.config import Config
from hil_gateway.gateway.perceive.duration import JITTER_S, UNSEEN_S
from hil_gateway.gateway.perceive.monitors.sensors import JUDGED_FROM, SPEED_WINDOW
from hil_gateway.gateway.perceive.motion import POWERED, Motion, wheel_speeds
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.settings.gateway import PERIOD_S

WHEEL_M_S, WHEEL_SHARE = 2.5, 0.15
"""a wheel further from the others than this (and their own differences in the tightest bend: 1.6 m of track at 1 rad/s)
has a wrong sensor, or is locked or spinning"""
OTHERS_SHARE = 0.06
"""the other three agree within this and 1 m/s: else it is the car that moves so"""
PEDAL_RATE = 0.3
"""with pedals or brakes in use a wheel may really spin or lock for some tenths of a second: time counts a third"""
INNER = 0.5
"""of the braking that takes all of the declared grip, from which an inner wheel may lock: at the limit of a bend it
carries less than half of what the outer one does, and is braked as hard. It may stay locked as long as that lasts"""
LIGHTEST = 0.9
"""kg m2 of a race car's wheel with its disc: full pressure on one that nothing turns slows it down the most"""


class LockedWheels:
    """Whether wheels may have slipped away from the car's speed: brakes that pressed harder than `share` of what the
    tyres' declared grip takes within the last half second."""

    def __init__(self, config: Config, share: float = 1.0) -> None:
        self._stop, self._vehicle, self._share = config.gateway.stop, config.vehicle, share
        self._per_pa = config.powertrain.brake_force_per_pa / config.vehicle.mass
        self._since = SPEED_WINDOW
        """periods"""

    def step(self, state: VehicleState, speed: float) -> bool:
        """Once a period."""
        braking = (state.brake_front + state.brake_rear) * self._per_pa
        self._since = 0 if braking > self._share * self._stop.grip(self._vehicle, speed) else self._since + 1
        return self._since < SPEED_WINDOW


class WheelMonitor:
    """One wheel against the three others, which agree; a slower one that the brakes may have locked is not judged."""

    def __init__(self, config: Config) -> None:
        train, radius = config.powertrain, config.vehicle.wheel_radius
        torque = 0.5 * train.brake_force_per_pa * train.brake_pressure_max * radius
        self._jump = torque / LIGHTEST * radius * PERIOD_S
        """m/s that no wheel slows down by in a period"""
        self._half_track = 0.25 * (config.vehicle.track_front + config.vehicle.track_rear)
        self._locked = LockedWheels(config, INNER)
        self._before: tuple[float, ...] = ()
        self.all_fell = False
        """in this period all wheels have slowed down faster than brakes can make them"""
        self._jumped = False
        """the wheel that is apart got there faster than a wheel can"""
        self._held_s = 0.0
        self._last_ns: int | None = None

    def step(self, now_ns: int, state: VehicleState, motion: Motion) -> float:
        """Seconds one wheel has disagreed."""
        dt = 0.0 if self._last_ns is None else min((now_ns - self._last_ns) / NS_PER_S, UNSEEN_S)
        self._last_ns = now_ns
        locked, apart = self._locked.step(state, motion.speed), self._one_apart(state, motion)
        fell = [fell and dt < JITTER_S for fell in self._fell(state)]
        self.all_fell = len(fell) > 0 and all(fell)
        self._jumped = apart != 0.0 and (self._jumped or any(fell))
        if apart == 0.0:
            self._held_s = 0.0
        elif self._jumped:
            self._held_s += dt
        elif apart > 0.0 or not locked:
            self._held_s += dt * (PEDAL_RATE if abs(state.drive) > POWERED else 1.0)
        return self._held_s

    def _fell(self, state: VehicleState) -> list[bool]:
        """Of every wheel, whether it has slowed down faster than brakes can make it; none in the first period."""
        before, self._before = self._before, wheel_speeds(state)
        return [last - now > self._jump for last, now in zip(before, self._before, strict=False)]

    def _one_apart(self, state: VehicleState, motion: Motion) -> float:
        """By how much one wheel is faster than the others, m/s; 0 while it may be."""
        inner = motion.yaw_rate * self._half_track
        speeds = [v + inner * side for v, side in zip(wheel_speeds(state), (1, -1, 1, -1), strict=True)]
        ordered = sorted(speeds)
        for odd, others in ((ordered[0], ordered[1:]), (ordered[-1], ordered[:-1])):
            middle = others[1]
            agree = others[-1] - others[0] <= 1.0 + OTHERS_SHARE * middle
            if middle > JUDGED_FROM and agree and abs(odd - middle) > WHEEL_M_S + WHEEL_SHARE * middle:
                return odd - middle
        return 0.0

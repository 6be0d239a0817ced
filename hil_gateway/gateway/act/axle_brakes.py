"""Brakes of a stop, axle by axle: front wheels that lock are let roll, and where an axle fails, a tyre flat or a
circuit weak, neither is asked for more than its tyres give.

Sound brakes press as declared; on tyres worse than declared they lock the front wheels, which then no longer steer.
Where one axle gives less, the other takes over as far as its own tyres bear it. Axles
bear different shares of the load, and the engine drags at the rear one alone. A front axle that is braked too hard
turns the car less; a rear one spins it. So beside a flat tyre the rear tyres are reckoned with less grip than declared.
Of an axle with load N and the share m of the mass: F <= sqrt((mu N)^2 - (m a_y)^2) beside the lateral specific force
a_y (friction circle; W. F. Milliken and D. L. Milliken, Race Car Vehicle Dynamics, 1995, ch. 2). An axle whose wheels
slip all the same is let go until they roll. A circuit that reports less than it is asked for is asked for more; then
every brake is needed, and the rear tyres count with all of the declared grip.
"""

from __future__ import annotations

from dataclasses import dataclass

from hil_gateway.bus.messages import VehicleState
from hil_gateway.car.actuation import PRESSED, ActuatorPositions
from hil_gateway.car.car import Car
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.gateway.perceive.monitors.actuators import PEDALS, BrakesDue
from hil_gateway.gateway.perceive.motion import Motion
from hil_gateway.gateway.perceive.positions.fixes import MOVING
from hil_gateway.gateway.perceive.road_speed import at_the_middle
from hil_gateway.settings.gateway import LEAST_SHARE, PERIOD_S, beside

SLIPS = (0.08, 0.06)
"""slip of the faster wheel, front and rear, beyond which an axle is let go: racing tyres give most at 0.1, and without
lateral force"""
PRESS_AGAIN_S = 1.5
"""until the whole pressure is back"""
WEAKEST = 0.15
"""share below which a circuit is not asked for still more"""


@dataclass(frozen=True, slots=True)
class AxleDemand:
    """What limits the brakes in this period."""

    lateral: float
    """specific force that the car has or its way needs, m/s2"""
    flat_front: bool
    flat_rear: bool
    """a tyre of that axle is flat: both of its brakes press alike, and would lock it"""
    engine_drag: float = 0.0
    """of the engine at the rear wheels with the throttle closed, N"""


class AxleBrakes:
    """Pressures of both circuits, once a period of a stop; `start` with it."""

    def __init__(self, car: Car, lateral_grip: float) -> None:
        """`lateral_grip`: declared friction coefficient of the tyres."""
        self._vehicle, self._grip, train = car.vehicle, lateral_grip, car.powertrain
        self._sure = 1.0 - car.grip_spread
        """share of the grip that the rear tyres are reckoned with, and the front ones where they brake for weak rear
        brakes: with all of what is left beside the lateral force they do not turn the car"""
        self._per_pa, self._most = train.brake_force_per_pa, train.brake_pressure_max
        self._held = [self._most, self._most]
        """Pa that slipping wheels have left to the front and to the rear circuit"""
        self._due = BrakesDue(car.actuators)
        self._answers = [1.0, 1.0]
        """share of its command that the front and the rear circuit report, 1 where that is a sound one's"""

    def watch(self, state: VehicleState, on_wire: ActuatorPositions) -> None:
        """What the circuits report of their commands; in every period, so that a stop begins with what is known."""
        self._due.step((on_wire.brake_front, on_wire.brake_rear))
        scatter, reported = PEDALS * self._most, (state.brake_front, state.brake_rear)
        if state.sources["pedals"].valid:
            for circuit, (pressure, due) in enumerate(zip(reported, self._due.least, strict=True)):
                if due > scatter:
                    self._answers[circuit] = pressure / due if pressure < due - scatter else 1.0

    def start(self) -> None:
        """A stop begins: nothing slips yet."""
        self._held = [self._most, self._most]

    def step(
        self, wanted: ActuatorPositions, demand: AxleDemand, state: VehicleState, motion: Motion
    ) -> ActuatorPositions:
        """`wanted` with front brakes that leave the wheels rolling; where an axle fails with the pressures that the
        axles bear."""
        fails = demand.flat_front or demand.flat_rear or self._weak
        asked = wanted.brake_front, wanted.brake_rear
        pressures = self.shared(wanted, demand, motion.speed) if fails else asked
        if motion.by_wheels and motion.speed > MOVING:
            self._watch(pressures, self._slips(state, motion))
        if not fails:
            return wanted._replace(brake_front=min(wanted.brake_front, self._held[0]))
        limited = (min(pair) for pair in zip(pressures, self._held, strict=True))
        front, rear = (min(p / max(a, WEAKEST), self._most) for p, a in zip(limited, self._answers, strict=True))
        return wanted._replace(brake_front=front, brake_rear=rear)

    @property
    def _weak(self) -> bool:
        """Whether a circuit reports less than it is asked for."""
        return min(self._answers) < 1.0

    def shared(self, wanted: ActuatorPositions, demand: AxleDemand, speed: float) -> tuple[float, float]:
        """Pressures of both circuits: what the rear one leaves is asked of the front one, as far as it goes, Pa."""
        total = wanted.brake_front + wanted.brake_rear
        front_most, rear_most = self._bears(speed, total * self._per_pa, demand)
        rear = 0.0 if demand.flat_rear else min(wanted.brake_rear, rear_most / self._per_pa)
        more = 0.0 if demand.flat_front else front_most / self._per_pa
        front = min(total - rear, max(wanted.brake_front, more), self._most)
        if self._answers[1] < 1.0:
            front = min(front, self._sure * front_most / self._per_pa)
        return front, rear

    def _bears(self, speed: float, braking: float, demand: AxleDemand) -> tuple[float, float]:
        """Force of the front and of the rear brakes at most, N, in a car that brakes with `braking` (N)."""
        car, grip = self._vehicle, self._grip
        pressed, moved = 0.5 * car.air_density * speed**2, braking * car.cg_height / car.wheelbase
        front = grip * (car.static_load_front - car.lift_area_front * pressed + moved)
        share = 1.0 if self._weak else self._sure
        rear = share * grip * (car.static_load_rear - car.lift_area_rear * pressed - moved)
        across = demand.lateral / GRAVITY
        left_front, left_rear = (
            beside(across * car.static_load_front, front),
            beside(across * car.static_load_rear, rear),
        )
        return left_front, max(left_rear - demand.engine_drag, 0.0)

    def _slips(self, state: VehicleState, motion: Motion) -> tuple[float, float]:
        """Slip of the faster wheel of each axle: an inner one may lock in a bend, and carries little."""
        fl, fr, rl, rr = at_the_middle(state, self._vehicle, motion.yaw_rate)
        return 1.0 - max(fl, fr) / motion.speed, 1.0 - max(rl, rr) / motion.speed

    def _watch(self, pressures: tuple[float, float], slips: tuple[float, float]) -> None:
        """Let an axle go that slips, by as much of its pressure a period as it slips beyond (at 0.05 half of it is gone
        within 0.14 s, before a wheel stands), and press again where it rolls."""
        for axle, (pressure, slip, bound) in enumerate(zip(pressures, slips, SLIPS, strict=True)):
            if slip > bound:
                share = max(1.0 - (slip - bound), LEAST_SHARE)
                self._held[axle] = max(share * min(self._held[axle], pressure), PRESSED)
            else:
                self._held[axle] = min(self._held[axle] + self._most / PRESS_AGAIN_S * PERIOD_S, self._most)

"""Whether physics allows a stop on the road: the best of many stops that know the true state and the fault at once.

The plant alone is driven on from the present state, once for each of a family of stops: steering along the way of a
stop by the true pose, with several decelerations and shares of grip, the brakes as declared or axle by axle, by path
and yaw rate or by the declared axles with the true side slip, and brakes held at several pressures and balances with
the steering as it is. The actuators are as broken as in the fault.
Where even the best of them leaves the road, physics does not allow a stop, as far as this family goes: a fault is then
no fault of monitors or of the stop.
"""

from __future__ import annotations

import json
import math
import os
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

from hil_gateway.car.actuation import Actuation, ActuatorPositions
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.config import Config
from hil_gateway.gateway.act.axle_brakes import AxleBrakes, AxleDemand
from hil_gateway.gateway.act.limits import Limits
from hil_gateway.gateway.act.stopping import Stopping
from hil_gateway.gateway.perceive.dead_reckoning import Pose
from hil_gateway.gateway.perceive.motion import Motion
from hil_gateway.observer import lateral
from hil_gateway.observer.axles import Axles
from hil_gateway.observer.axles import axles as axles_of
from hil_gateway.observer.observer import SLOWEST
from hil_gateway.plant.car import Car, Commands
from hil_gateway.plant.plant import CONTROLLER_STEPS, Plant
from hil_gateway.settings.gateway import PERIOD_S

DECELERATIONS = (3.0, 12.0, 30.0)
"""m/s2 that a stop along its way asks for: from rolling out to locking the wheels"""
GRIPS = (1.3, 3.0)
"""g: what it takes the tyres for, from the gateway's declared grip to more than any tyre holds"""
PRESSURES = (0.0, 0.5e6, 1.5e6, 3e6, 6e6)
"""Pa in both circuits together, with the steering as it is"""
BALANCES = (-1.0, 0.0, 1.0)
"""of those: rear brakes alone, both alike, front brakes alone"""
STANDS_WITHIN_S = 25.0
FAR_OFF = 3.0
"""m off the road: how far the car goes on from there does not matter"""


@dataclass(frozen=True)
class Best:
    """Least distance of a wheel to the edge in the best stop, m, negative off the road; and which stop that is."""

    margin_m: float
    stop: str


Driver = Callable[[], ActuatorPositions]


def best_stop(plant: Plant, config: Config, actuate: Callable[[Commands, Commands], Commands] | None) -> Best:
    """The best stop from the plant's present state on, which it leaves as it is; every stop runs in a forked copy."""
    best = Best(-math.inf, "none")
    for name, driver in _stops(plant, config):
        margin = in_a_copy(partial(_margin, plant, config, driver, actuate))
        best = max(best, Best(margin, name), key=lambda b: b.margin_m)
        if best.margin_m >= 0.0:
            break
    return best


def in_a_copy(simulate: Callable[[], Any]) -> Any:
    """What `simulate` returns (JSON), run in a forked copy of this process."""
    reader, writer = os.pipe()
    if not (pid := os.fork()):
        status = 1
        try:
            os.write(writer, json.dumps(simulate()).encode())
            status = 0
        finally:
            os._exit(status)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        text = pipe.read()
    os.waitpid(pid, 0)
    if not text:
        raise RuntimeError("the copy that simulated died; its traceback is on standard error")
    return json.loads(text)


def _stops(plant: Plant, config: Config) -> Iterator[tuple[str, Callable[[], Driver]]]:
    """Name and maker of each stop of the family."""
    for grip in GRIPS:
        for deceleration in DECELERATIONS:
            for by_axle, slides in product((False, True), repeat=2):
                how = f"{', axle by axle' if by_axle else ''}{', into slides' if slides else ''}"
                name = f"along its way, {deceleration:g} m/s2 at {grip:g} g{how}"
                yield name, partial(_along_its_way, plant.car, config, deceleration, grip, by_axle, slides)
    held = plant.car["steer"] * config.vehicle.steering_ratio
    for pressure in PRESSURES:
        for balance in BALANCES if pressure else (0.0,):
            front, rear = 0.5 * pressure * (1 + balance), 0.5 * pressure * (1 - balance)
            brakes = ActuatorPositions(held, 0.0, front, rear, plant.car.gear)
            yield f"brakes at {front / 1e6:g} and {rear / 1e6:g} MPa", partial(_held, brakes)


def _held(brakes: ActuatorPositions) -> Driver:
    return lambda: brakes


def _along_its_way(  # noqa: PLR0917 - what stops of the family differ by
    car: Car, config: Config, deceleration: float, grip: float, by_axle: bool, slides: bool
) -> Driver:
    changes = {
        "controlled_deceleration": deceleration, "emergency_deceleration": max(deceleration, 12.0), "lateral_grip": grip
    }  # fmt: skip
    stop = config.gateway.stop.model_copy(update=changes)
    actuation = Actuation(config.vehicle, config.powertrain)
    stopping = Stopping(config.declared_car, stop, car.road.track)
    stopping.start(car["steer"])
    stopping.flat = by_axle and any(car.flats)
    axles = AxleBrakes(config.declared_car, grip)
    waiting = deque([car["steer"]], maxlen=round(config.car.actuators.steering_late / PERIOD_S))

    def drive() -> ActuatorPositions:
        motion = Motion(car["vx"], car["yaw_rate"], car["vx"] * car["yaw_rate"])
        pose = Pose(car["x"], car["y"], car["yaw"], car["vx"], math.atan2(car["vy"], car["vx"]))
        known = _axles(car, config).onward(waiting) if slides and car["vx"] > SLOWEST else None
        steer, braking = stopping.command(motion, pose, emergency=False, axles=known)
        waiting.append(steer)
        wanted = actuation.to_actuators(steer, braking, car.gear, 0.0, car.gear)
        if not by_axle:
            return wanted
        demand = AxleDemand(stopping.lateral or 0.0, any(car.flats[:2]), any(car.flats[2:]))
        front, rear = axles.shared(wanted, demand, car["vx"])
        return wanted._replace(brake_front=front, brake_rear=rear)

    return drive


def _axles(car: Car, config: Config) -> Axles:
    """Declared axles of a car that moves as it does, its brakes off."""
    x = lateral.prior(config.car)[0].tolist()
    x[lateral.VY], x[lateral.R] = car["vy"], car["yaw_rate"]
    track = car.road.track
    bank = float(track.at(track.project(car["x"], car["y"])[0]).bank)
    silent = dict.fromkeys(lateral.LateralPeriod._fields, 0.0) | {"dt": PERIOD_S, "speed": car["vx"], "steers": 1.0}
    period = lateral.LateralPeriod(**silent)._replace(gravity_across=GRAVITY * math.sin(bank))
    return axles_of(config.vehicle, config.car.tyres.load_sensitivity, x, period)


def _margin(
    plant: Plant, config: Config, driver: Callable[[], Driver], actuate: Callable[[Commands, Commands], Commands] | None
) -> float:
    """Drives the plant's car, its engine cut, until it stands or is far off the road."""
    drive, side = driver(), _side(actuate)
    car, referee, limits = plant.car, plant.referee, Limits(config.car, config.gateway.limits.within(config.car))
    on_wire, did = limits.resting(car["steer"] * config.vehicle.steering_ratio), plant.obeyed
    referee.worst_margin_m = math.inf
    until_s = car.time_s + STANDS_WITHIN_S
    while car.time_s < until_s and not car.standing and referee.worst_margin_m > -FAR_OFF:
        wanted = drive()
        on_wire, _ = limits.apply(wanted._replace(steering_motor=side * wanted.steering_motor), on_wire)
        asked = _commands(limits.to_actuators(on_wire), config)
        did = asked if actuate is None else actuate(asked, did)
        for _ in range(CONTROLLER_STEPS):
            car.step(did, engine_running=False)
        referee.step(car.time_s)
    return referee.worst_margin_m


def _side(actuate: Callable[[Commands, Commands], Commands] | None) -> float:
    """-1 where the steering goes to the other side than it is asked to: a stop that knows asks for the other side."""
    asked = Commands(steer=0.1)
    return -1.0 if actuate is not None and actuate(asked, asked).steer < 0.0 else 1.0


def _commands(actuators: ActuatorPositions, config: Config) -> Commands:
    steer = actuators.steering_motor / config.vehicle.steering_ratio
    return Commands(steer, actuators.accelerator, actuators.brake_front, actuators.brake_rear, actuators.gear)

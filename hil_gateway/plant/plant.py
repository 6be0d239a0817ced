"""The simulated AV-24 as one core: CAN frames in, CAN frames out, physics at 1 kHz in between."""

from __future__ import annotations

import random
from dataclasses import replace
from typing import Any

from hil_gateway.bus.interface import Bus
from hil_gateway.bus.topics import TRUTH
from hil_gateway.can_link import CanLink
from hil_gateway.config import Config, PlantConfig
from hil_gateway.plant.car import STEP_S, Car, Commands
from hil_gateway.plant.car_file import SimulatedCar
from hil_gateway.plant.controller.base_station import Desk, SimulatedRaceControl
from hil_gateway.plant.controller.ladder import MARELLI_KILL, PARKED, CarState, VehicleController
from hil_gateway.plant.controller.receive import CommandReceiver
from hil_gateway.plant.controller.sensors import SimulatedSensors
from hil_gateway.plant.controller.transmit import ReportTransmitter
from hil_gateway.plant.fitted import fitted
from hil_gateway.plant.physics.effects import configure
from hil_gateway.plant.physics.parameters import PlantParameters
from hil_gateway.plant.receivers import SimulatedReceivers
from hil_gateway.plant.referee.referee import Referee
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track

STEP_NS = round(STEP_S * NS_PER_S)
CONTROLLER_STEPS = 10
"""the vehicle controller runs at 100 Hz"""
FARTHEST = 10.0
"""factor up to which a number of the car may differ from the usual: the physics holds there"""
CATCH_UP_NS = NS_PER_S // 5
"""a process that was held up loses what is older: it must not answer with a burst of stale frames"""


def plant_parameters(config: PlantConfig) -> PlantParameters:
    """Parameters of a configuration: base, effects, then single numbers of the car.

    Raises:
        InputError: unknown base, effect or number, or a size outside its range.
    """
    parameters = configure(config.base, config.effects)
    for name, value in config.car.items():
        usual = getattr(parameters.car, name, None)
        if not isinstance(usual, float):
            raise InputError(f"plant.car.{name} is not a number of the simulated car; docs/plant.md lists them")
        if usual > 0 and not 1 / FARTHEST <= value / usual <= FARTHEST:
            raise InputError(
                f"plant.car.{name} = {value:g} is no car: between {usual / FARTHEST:g} and {usual * FARTHEST:g}"
            )
        changed: Any = {name: value}
        parameters = replace(parameters, car=replace(parameters.car, **changed))
    return parameters


class Plant:
    """`step(now_ns)` advances the car to `now_ns` and exchanges frames with the computer."""

    def __init__(
        self, config: Config, link: CanLink, truth_bus: Bus | None = None, track: Track | None = None,
        simulated: SimulatedCar | None = None,
    ) -> None:  # fmt: skip
        """`simulated` replaces the configuration's base, effects and numbers of the car."""
        asked = simulated.parameters() if simulated else plant_parameters(config.plant)
        parameters = fitted(asked, config.car)
        track, events = track or load_track(config.track or None), simulated.events if simulated else ()
        self.car = Car(parameters, track, start_s=config.plant.start_s, events=events)
        self.controller = VehicleController()
        self.race_control = SimulatedRaceControl()
        self._desk = Desk(truth_bus, self.race_control) if truth_bus else None
        self.referee = Referee(self.car)
        self.receivers = SimulatedReceivers(config, self.car)
        self._receiver = CommandReceiver(config.car)
        sensors = SimulatedSensors(self.car, parameters.sensors, config.car, config.origin, config.plant.seed)
        self._transmitter = ReportTransmitter(
            platform=config.car,
            link=link,
            car=self.car,
            sensors=sensors,
            controller=self.controller,
            referee=self.referee,
            race_control=self.race_control,
            positions=config.plant.can_positions,
        )
        self._link, self._truth_bus = link, truth_bus
        self._reached_ns: int | None = None
        self._obeyed, self._engine_running = PARKED, False
        self._truth_ns = 0

    @property
    def obeyed(self) -> Commands:
        """What the actuators get."""
        return self._obeyed

    def run_free(self, now_ns: int, rng: random.Random) -> None:
        """Before the first step: the nodes of the car are to have clocks of their own."""
        self._transmitter.run_free(now_ns, rng)

    def step(self, now_ns: int) -> None:
        """Advance to `now_ns` (monotonic, ns) in whole milliseconds."""
        self._receiver.take(self._link.receive(0.0), now_ns)
        if self._desk:
            self._desk.step(now_ns)
        if self._reached_ns is None or now_ns - self._reached_ns > CATCH_UP_NS:
            self._reached_ns = now_ns - STEP_NS
        reached_ns, car, transmitter = self._reached_ns, self.car, self._transmitter
        while now_ns - reached_ns >= STEP_NS:
            reached_ns += STEP_NS
            if car.steps % CONTROLLER_STEPS == 0:
                self._supervise(reached_ns)
            car.step(self._obeyed, self._engine_running)
            self.referee.loads.step()
            self.receivers.step(reached_ns)
            if reached_ns >= transmitter.next_ns:
                transmitter.step(reached_ns, self._receiver.received)
        self._reached_ns = reached_ns
        if self._truth_bus is not None and reached_ns - self._truth_ns >= TRUTH.period_ns:
            self._truth_ns = reached_ns
            self._truth_bus.publish(TRUTH, self.referee.truth(reached_ns))

    def _supervise(self, t_ns: int) -> None:
        """The vehicle controller's own period: ladder, supervision, what the actuators get; and the referee's look."""
        received, before = self._receiver.received, self.controller.state
        if self.race_control.vehicle_flag in MARELLI_KILL:
            self.controller.kill("race control")
        self.controller.step(t_ns, received, self.car.standing)
        if before is CarState.EMERGENCY and self.controller.state is not before:
            self._receiver.forget()
        self._obeyed, self._engine_running = self.controller.obeyed(t_ns, received), self.controller.engine_running
        self.referee.step(self.car.time_s)

"""The plant as a process: real clock, real CAN."""

from __future__ import annotations

from hil_gateway.bus.zenoh_bus import open_bus
from hil_gateway.can_link import open_link
from hil_gateway.config import Config
from hil_gateway.plant.car_file import SimulatedCar
from hil_gateway.plant.plant import Plant
from hil_gateway.plant.receivers import Ports
from hil_gateway.process.clock import SystemClock, next_due, wall_offset_ns
from hil_gateway.process.lifecycle import StopRequest
from hil_gateway.process.scheduling import punctual

PERIOD_NS = 2_000_000
"""wake-ups; the physics inside steps every millisecond"""


def run_plant(config: Config, simulated: SimulatedCar | None = None) -> None:
    """Run until SIGINT or SIGTERM.

    Raises:
        InputError: no such CAN interface, or a port of a receiver that is busy.
    """
    stopped = StopRequest()
    clock = SystemClock()
    link = open_link(config.can)
    bus = open_bus(config.zenoh, "plant")
    plant = Plant(config, link, bus, simulated=simulated)
    ports = Ports({name: given.address for name, given in config.receivers.items() if config.plant.receivers})
    punctual("plant")
    due_ns = clock.now_ns()
    try:
        while not stopped():
            plant.receivers.unix_offset_ns = wall_offset_ns()
            plant.step(due_ns)  # reports leave when they are due, not with the jitter of this process
            ports.send(plant.receivers.due(clock.now_ns()))
            due_ns = next_due(due_ns, clock.now_ns(), PERIOD_NS)
            clock.sleep_until(due_ns)
    finally:
        ports.close()
        bus.close()
        link.close()

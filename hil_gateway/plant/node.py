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
    next_ns = clock.now_ns()
    try:
        while not stopped():
            plant.receivers.unix_offset_ns = wall_offset_ns()
            plant.step(clock.now_ns())
            ports.send(plant.receivers.due(clock.now_ns()))
            next_ns = next_due(next_ns, clock.now_ns(), PERIOD_NS)  # timers of a car do not shift when this one is late
            clock.sleep_until(next_ns)
    finally:
        ports.close()
        bus.close()
        link.close()

"""Gateway process: the core on the system clock, every 10 ms.

An exception in the core is a bug: it ends the process at once. The frames stop with it, the car sees the counters
stand still and stops by itself, and whatever restarts the process gets a gateway that is silent.
"""

from __future__ import annotations

import gc
import logging
import os
import socket

from hil_gateway.bus.zenoh_bus import HUB, open_bus
from hil_gateway.can_link import open_link
from hil_gateway.config import Config
from hil_gateway.gateway.core import Gateway
from hil_gateway.gateway.events.log import EventLog, journal_line
from hil_gateway.gateway.period import ANSWER_NS, LATEST_NS, next_period
from hil_gateway.gateway.running import announced
from hil_gateway.process.clock import NS_PER_S, SystemClock, wait_for
from hil_gateway.process.journal import Journal
from hil_gateway.process.lifecycle import StopRequest
from hil_gateway.process.processor_wait import describe_load
from hil_gateway.process.scheduling import punctual
from hil_gateway.track.loading import load_track


def run(config: Config) -> None:
    """Run until SIGINT or SIGTERM, and on until a car that moves by its commands stands; a second signal ends at once.
    The last frames say controlled shutdown.

    Raises:
        InputError: no such CAN interface, busy port, broken track file.
    """
    stopped = StopRequest()
    track = load_track(config.track)
    link = open_link(config.can)
    try:
        bus = open_bus(config.zenoh, HUB)
    except BaseException:
        link.close()
        raise
    gateway = Gateway(config, bus, link, track, describe_load)
    ending = OrderlyEnd(gateway, config.gateway.stop.controlled_deceleration)
    journal, notify = Journal(), Notifier()
    events = EventLog(bus, lambda event: journal.say(journal_line(event)))
    punctual("gateway")
    gc.freeze()  # what start-up allocated is never collected: shorter pauses
    clock = SystemClock()
    due_ns = clock.now_ns()
    notify.send("READY=1")
    try:
        with journal, announced(config):
            while not ending.over(clock.now_ns(), stopped.count):
                began_ns = clock.now_ns()
                gateway.observe(began_ns)
                if gateway.awaits_command:
                    clock.sleep_until(due_ns + ANSWER_NS)
                    wait_for(clock, lambda: gateway.has_command(clock.now_ns()), due_ns + LATEST_NS)
                gateway.answer(clock.now_ns())
                events.step(clock.now_ns(), gateway, link.stats().bus_state)
                notify.send("WATCHDOG=1")
                due_ns = next_period(due_ns, clock.now_ns(), began_ns - gateway.newest_report_ns)
                clock.sleep_until(due_ns)
        gateway.shut_down(clock.now_ns())
    finally:
        notify.send("STOPPING=1")
        bus.close()
        link.close()


class Notifier:
    """systemd's notification protocol (sd_notify(3)); silent where there is no systemd."""

    def __init__(self) -> None:
        self._address = os.environ.get("NOTIFY_SOCKET", "").replace("@", "\0", 1)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)

    def send(self, message: str) -> None:
        """Tell systemd; a full or absent socket must not cost a period."""
        if self._address:
            try:
                self._socket.sendto(message.encode(), self._address)
            except OSError:
                return


LONGEST_STOP = 2.0
"""times what the configured deceleration takes from the speed at the request: brakes may be half as good"""
log = logging.getLogger(__name__)


class OrderlyEnd:
    """Asks a gateway to stop the car, and says when its process may end.

    Commands that end at once leave the car with its last steering until its own emergency has stopped it.
    """

    def __init__(self, gateway: Gateway, deceleration: float) -> None:
        """`deceleration` of a controlled stop, m/s2."""
        self._gateway, self._deceleration = gateway, deceleration
        self._due_ns: int | None = None

    def over(self, now_ns: int, requests: int) -> bool:
        """Whether the process may end before this period, having been asked to `requests` times: the car stands, does
        not obey or is out of reach, or a second request is in a hurry."""
        if requests == 0:
            return False
        if requests > 1 or not self._gateway.moves_car:
            return True
        if self._due_ns is None:
            self._gateway.begin_ending()
            longest_s = LONGEST_STOP * self._gateway.speed / self._deceleration
            self._due_ns = now_ns + round(longest_s * NS_PER_S)
        if now_ns < self._due_ns:
            return False
        log.warning("the gateway ends at %.1f m/s: the stop takes longer than it may", self._gateway.speed)
        return True

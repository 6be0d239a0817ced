"""Plays a session back: in real time, scaled, or as fast as possible; to the bus, to CAN, or to a function.

Safety: only what a car says goes to a CAN bus, never a recorded command to its actuators; and commands are not
published either unless they are asked for by name.
"""

from __future__ import annotations

import heapq
import logging
from collections.abc import Callable, Iterable, Iterator

from hil_gateway.bus.interface import Bus
from hil_gateway.bus.playback import Playback
from hil_gateway.bus.topics import COMMAND, OPERATOR, PLAYBACK, TOPICS
from hil_gateway.can_link import CanLink
from hil_gateway.process.clock import NS_PER_S, Clock
from hil_gateway.process.errors import InputError
from hil_gateway.session.files.format import CAN_TOPIC, unpack_frame, unpack_message
from hil_gateway.session.files.reader import Item

WINDOW_NS = NS_PER_S // 2
"""messages are recorded in the order they were picked up, at most this much out of order of their stamps"""

LONG_WAIT_NS = 10 * NS_PER_S
log = logging.getLogger(__name__)

Send = Callable[[Item], None]
DEFAULT_TOPICS = tuple(t.key for t in TOPICS if t.recorded and t not in (COMMAND, OPERATOR))


def in_order(items: Iterable[Item]) -> Iterator[Item]:
    """Items by time of publication; equal times keep their order in the file.

    What was delayed by more than the window comes late; where the clock was set back a new stretch begins.
    """
    heap: list[tuple[int, int, Item]] = []
    newest_ns = 0
    for number, item in enumerate(items):
        set_back = item.log_ns < newest_ns - WINDOW_NS
        while heap and (set_back or heap[0][0] < item.log_ns - WINDOW_NS):
            yield heapq.heappop(heap)[2]
        newest_ns = item.log_ns if set_back else max(newest_ns, item.log_ns)
        heapq.heappush(heap, (item.publish_ns, number, item))
    while heap:
        yield heapq.heappop(heap)[2]


def replay(items: Iterable[Item], send: Send, clock: Clock, speed: float = 1.0) -> int:
    """Give every item to `send` at its time divided by `speed` (0: at once); returns the number of items.

    The schedule is absolute: a slow receiver delays, but does not stretch what follows. It begins anew where the clock
    was set back.
    """
    count, start_ns, first_ns, newest_ns = 0, 0, 0, 0
    for item in items:
        if count == 0 or item.log_ns < newest_ns - WINDOW_NS:
            start_ns, first_ns, newest_ns = clock.now_ns(), item.publish_ns, item.log_ns
        newest_ns = max(newest_ns, item.log_ns)
        if speed > 0:
            _wait(clock, start_ns + int((item.publish_ns - first_ns) / speed))
        send(item)
        count += 1
    return count


def _wait(clock: Clock, due_ns: int) -> None:
    if due_ns - clock.now_ns() > LONG_WAIT_NS:
        log.warning("nothing was recorded for a while: waiting %.0f s", (due_ns - clock.now_ns()) / NS_PER_S)
    clock.sleep_until(due_ns)


def to_bus(bus: Bus, keys: Iterable[str] = DEFAULT_TOPICS) -> Send:
    """Publishes messages of the topics `keys`, unchanged.

    Raises:
        InputError: a key that is not in the topics table.
    """
    by_key = {topic.key: topic for topic in TOPICS}
    if unknown := sorted(set(keys) - set(by_key)):
        raise InputError(f"unknown topic {unknown[0]}; known are {', '.join(by_key)}")
    chosen = {key: by_key[key] for key in keys}

    def send(item: Item) -> None:
        if topic := chosen.get(item.topic):
            bus.publish(topic, unpack_message(topic, item.data))

    return send


def announcing(bus: Bus, file: str, speed: float, clock: Clock) -> Send:
    """Says five times a second that a recording is being played: nobody shall take it for a live car."""
    first_ns, due_ns, seq = 0, 0, 0

    def send(item: Item) -> None:
        nonlocal first_ns, due_ns, seq
        first_ns, now_ns = first_ns or item.publish_ns, clock.now_ns()
        if now_ns >= due_ns:
            due_ns, seq = now_ns + NS_PER_S // 5, seq + 1
            at_s = max(item.publish_ns - first_ns, 0) / NS_PER_S
            bus.publish(PLAYBACK, Playback(stamp_ns=now_ns, seq=seq, file=file, position_s=at_s, speed=speed))

    return send


def to_can(link: CanLink, ids: frozenset[int]) -> Send:
    """Sends the raw frames whose identifier is in `ids`."""

    def send(item: Item) -> None:
        if item.topic == CAN_TOPIC:
            frame = unpack_frame(item.data)
            if frame.id in ids and not frame.is_error:
                link.send(frame.id, frame.data)

    return send

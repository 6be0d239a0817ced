"""Transmission to the bus: declared identifiers and lengths only, rolling counters, every message at its period.

There is no thread and no kernel timer behind the counters: when the process hangs they stop, and the car sees it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from can_dbc.codec import Codec
from can_dbc.database import BusMessage
from can_dbc.signals import SignalMap
from hil_gateway.can_link import CanLink
from hil_gateway.car.states import CtState, computer_codes
from hil_gateway.gateway.act.limits import RawCommand
from hil_gateway.gateway.decide.ladder_inputs import Flags
from hil_gateway.settings.gateway import PERIOD_S


def transmitted(signals: SignalMap) -> tuple[str, ...]:
    """The white-list: no other message ever leaves."""
    return signals.actuator_messages + signals.status_messages


@dataclass(slots=True)
class _Sent:
    """One message that leaves."""

    layout: BusMessage
    values: dict[str, int]
    """integers of all its signals: as they rest where nothing sets them"""
    signals: Mapping[str, str]
    """quantity -> its signal"""
    every: int
    """periods of the gateway between two frames"""
    wait: int = 0
    """periods until the next one is due"""
    counter: int = 0


class Transmitter:
    """Frames of the computer, counted."""

    def __init__(self, codec: Codec, link: CanLink, vehicle_number: int) -> None:
        self._codec = codec
        self._link = link
        self._vehicle_number = vehicle_number
        signals = codec.signals
        self._allowed = {codec.messages[name].id: codec.messages[name].dlc for name in transmitted(signals)}
        self._actuators = [_sent(codec, name) for name in signals.actuator_messages]
        self._status = [_sent(codec, name) for name in signals.status_messages]
        self._due_ns = dict.fromkeys(signals.status_messages, 0)
        self._states = computer_codes(signals.codes["ct_state"])
        self._reported: tuple[CtState, Flags] | None = None
        self.refused = 0
        self.failed = 0

    def may_send(self, frame_id: int, data: bytes) -> bool:
        """Whether the white-list has this identifier with this length."""
        return self._allowed.get(frame_id) == len(data)

    def send(self, frame_id: int, data: bytes) -> bool:
        """Send one frame if the white-list has it; False is counted."""
        if not self.may_send(frame_id, data):
            self.refused += 1
            return False
        sent = self._link.send(frame_id, data)
        self.failed += not sent
        return sent

    def actuators(self, command: RawCommand, before: RawCommand) -> tuple[RawCommand, bool]:
        """The actuator frames of one period: what now stands on the wire, and whether all that were due left.

        A frame that could not be sent leaves its values and its counter as they were `before`, so that the next one
        continues from what the car has really received; so does one that is not due.
        """
        stands, all_left = command, True
        for message in self._actuators:
            message.wait -= 1
            due = message.wait < 0
            left = due and self._message(message, {s: getattr(command, name) for name, s in message.signals.items()})
            message.wait = message.every - 1 if left else message.wait if not due else 0
            all_left = all_left and (left or not due)
            if not left:
                stands = stands.with_those_of(before, message.signals)
        return stands, all_left

    def race_control(self, now_ns: int, ct_state: CtState, flags: Flags) -> None:
        """State and acknowledged flags, on every change and once a period of each message."""
        changed, self._reported = (ct_state, flags) != self._reported, (ct_state, flags)
        due = [m for m in self._status if changed or now_ns >= self._due_ns[m.layout.name]]
        if not due:
            return
        content = {
            "ct_state": self._states[ct_state],
            "vehicle_number": self._vehicle_number,
            **{f"{flag}_ack": code for flag, code in flags.items()},
        }
        places = self._codec.signals.commands
        for message in due:
            self._due_ns[message.layout.name] = now_ns + round(message.layout.period_s * 1e9)
            raw = {signal: places[key].raw(content[key]) for key, signal in message.signals.items()}
            self._message(message, raw)

    def _message(self, message: _Sent, raw: Mapping[str, int]) -> bool:
        """Set values and counter, pack, send: the integers that were checked are those in the bytes."""
        values, counter = message.values, message.layout.counter
        values.update(raw)
        if counter is not None:
            values[counter.signal] = message.counter
        sent = self.send(*self._codec.pack(message.layout.name, values))
        message.counter = (message.counter + sent) % counter.modulus if counter is not None else 0
        return sent


def _sent(codec: Codec, name: str) -> _Sent:
    layout = codec.messages[name]
    signals = {key: place.signal.name for key, place in codec.signals.commands.items() if place.message is layout}
    rest = {signal.name: codec.at_rest(signal) for signal in layout.signals}
    return _Sent(layout, rest, signals, max(round(layout.period_s / PERIOD_S), 1))

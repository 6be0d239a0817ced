"""Why the car was stopped: the first cause and the last one since it was armed, kept until it is armed again."""

from __future__ import annotations

from typing import Any

from hil_gateway.bus.event import Event, EventKind


class StopStory:
    """`first` and `last` as events for the page; both None while nothing has stopped the car since arming."""

    def __init__(self) -> None:
        self.first: dict[str, Any] | None = None
        self.last: dict[str, Any] | None = None

    def take(self, event: Event) -> None:
        """Take in the next event."""
        if event.kind is EventKind.ARMING and event.after == "drive":
            self.first = self.last = None
        elif event.kind is EventKind.FAILSAFE:
            self.last = event.entry(0)
            self.first = self.first or self.last

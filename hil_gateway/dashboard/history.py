"""The last minutes of every channel, kept by the server: a page that is loaded again has lost nothing."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

from hil_gateway.bus.event import Event, EventKind
from hil_gateway.dashboard.channels import CHANNELS, DERIVED

NAMES = ("t", *(channel.name for channel in CHANNELS), *DERIVED)
MINUTES = 10


class History:
    """A bounded table; rows are dictionaries of `NAMES`, columns are what the page asks for."""

    def __init__(self, most: int) -> None:
        self._rows: deque[tuple[float | None, ...]] = deque(maxlen=most)

    def add(self, row: Mapping[str, float | None]) -> None:
        """Append one row; the oldest goes where there is no room."""
        self._rows.append(tuple(row.get(name) for name in NAMES))

    def columns(self) -> dict[str, list[float | None]]:
        """Name -> values, oldest first."""
        rows = list(self._rows)
        return {name: [row[i] for row in rows] for i, name in enumerate(NAMES)}

    def __len__(self) -> int:
        return len(self._rows)


class StopStory:
    """Why the car was stopped: `first` and `last` as events for the page; both None while nothing has stopped the car
    since arming."""

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

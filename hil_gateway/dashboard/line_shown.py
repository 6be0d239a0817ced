"""The race line and the corridor on the map: asked for by name, because they are large and seldom change."""

from __future__ import annotations

import zlib
from typing import Any

from hil_gateway.bus.race_line import RaceLine
from hil_gateway.dashboard.setup import edges
from hil_gateway.track.track import Track


class LineShown:
    """The newest line; `name` changes when what is drawn does."""

    def __init__(self, track: Track) -> None:
        self._track = track
        self._newest: RaceLine | None = None
        self.name = ""
        self.drawn: dict[str, Any] | None = None

    def take(self, message: RaceLine | None) -> None:
        """Take in the newest message."""
        if message is None or message is self._newest:
            return
        self._newest = message
        name = f"{zlib.crc32(repr((message.x, message.y, message.clearance_m)).encode()):08x}"
        if name == self.name:
            return
        self.name = name
        corridor = edges(self._track, message.clearance_m)
        self.drawn = {"name": name, "x": list(message.x), "y": list(message.y), "corridor": corridor}

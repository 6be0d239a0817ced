"""One connection of a browser: so many at once, and each must ask for something soon.

Without an end to both, who only connects takes every file the process may open, and each further attempt is a traceback
in the log.
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

MOST = 200
"""connections at once: a browser has one for each page, and up to six while it loads"""
ASKS_WITHIN_S = 10.0
"""from connecting to the whole of the first request"""


class Connection(H11Protocol):
    """HTTP as uvicorn speaks it, bounded."""

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        if len(self.connections) > MOST:
            transport.abort()
        else:
            asyncio.get_running_loop().call_later(ASKS_WITHIN_S, self._end_if_silent)

    def _end_if_silent(self) -> None:
        if self.cycle is None:
            self.transport.abort()

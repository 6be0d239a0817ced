"""HTTP side of the dashboard: three static files, the track, and a stream of server-sent events."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from hil_gateway.process.shipped import shipped

FOLDER = shipped("hil_gateway", "dashboard")
PAGES = {"/": "index.html", "/app.js": "app.js", "/style.css": "style.css"}
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; img-src data:; "
    + "; ".join(f"{kind}-src 'self'" for kind in ("script", "style", "connect")),
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}

Snapshot = Callable[[], dict[str, Any]]


def create_app(snapshot: Snapshot, outline: dict[str, Any], period_s: float) -> Starlette:
    """The web application; `snapshot` is called once a period, however many pages are open."""
    shared = _Shared(snapshot, period_s)

    def page(name: str) -> Callable[[Request], Response]:
        return lambda request: FileResponse(FOLDER / name, headers=HEADERS)

    async def events(request: Request) -> Response:
        return StreamingResponse(_stream(shared, request, period_s), media_type="text/event-stream", headers=HEADERS)

    def track(request: Request) -> Response:
        return JSONResponse(outline, headers=HEADERS)

    routes = [Route(path, page(name)) for path, name in PAGES.items()]
    return Starlette(routes=[*routes, Route("/track.json", track), Route("/events", events)])


class _Shared:
    """One snapshot for all pages."""

    def __init__(self, snapshot: Snapshot, period_s: float) -> None:
        self._snapshot, self._period_s = snapshot, period_s
        self._text, self._taken_s = "", float("-inf")

    def text(self) -> str:
        """The snapshot as one event, at most a period old."""
        now_s = asyncio.get_running_loop().time()
        if now_s - self._taken_s >= 0.5 * self._period_s:
            self._taken_s = now_s
            self._text = f"data: {json.dumps(self._snapshot(), allow_nan=False)}\n\n"
        return self._text


async def _stream(shared: _Shared, request: Request, period_s: float) -> AsyncIterator[str]:
    while not await request.is_disconnected():
        yield shared.text()
        await asyncio.sleep(period_s)

"""HTTP side of the dashboard: the files of the page, what never changes, the history, and a stream of events."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from pathlib import Path
from typing import Any, Protocol

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, Response, StreamingResponse
from starlette.routing import Route
from uvicorn.protocols.http.h11_impl import H11Protocol

from hil_gateway.process.errors import InputError
from hil_gateway.process.shipped import shipped

FOLDER = shipped("hil_gateway", "dashboard/page")
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; img-src data:; "
    + "; ".join(f"{kind}-src 'self'" for kind in ("script", "style", "connect")),
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
SLOW_S = 1.0
Lifespan = Callable[[Starlette], AbstractAsyncContextManager[None]]


class PageSource(Protocol):
    """What is shown: a live bus."""

    def snapshot(self) -> dict[str, Any]:
        """The quick part, of this moment."""
        ...

    def slow(self) -> dict[str, Any]:
        """The slow part."""
        ...

    def history(self) -> dict[str, Any]:
        """Columns of the last minutes."""
        ...

    def line(self, name: str) -> dict[str, Any] | None:
        """The race line the slow part named."""
        ...


def create_app(source: PageSource, setup: dict[str, Any], period_s: float) -> Starlette:
    """The live page; `source` is asked once a period, however many pages are open."""
    shared = _Shared(source, period_s)

    async def events(request: Request) -> Response:
        return StreamingResponse(_stream(shared, request, period_s), media_type="text/event-stream", headers=HEADERS)

    def history(request: Request) -> Response:
        return json_response(source.history())

    def line(request: Request) -> Response:
        return json_response(source.line(request.query_params.get("name", "")))

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        task = asyncio.create_task(shared.keep())
        yield
        task.cancel()

    answers = {"/events": events, "/history.json": history, "/line.json": line}
    return page_app(setup, [Route(name, answer) for name, answer in answers.items()], lifespan)


def page_app(setup: dict[str, Any], routes: list[Route], lifespan: Lifespan | None = None) -> Starlette:
    """The page's own files and its set-up, with the routes of what fills it."""
    files = {f"/{path.relative_to(FOLDER).as_posix()}": path for path in sorted(FOLDER.rglob("*")) if path.is_file()}
    pages = [Route(name, _page(path)) for name, path in {"/": FOLDER / "index.html", **files}.items()]
    fixed = Route("/setup.json", lambda request: json_response(setup))
    return Starlette(routes=[*pages, fixed, *routes], lifespan=lifespan)


def json_response(tree: Any) -> Response:
    """JSON with the headers every answer has."""
    return Response(text_of(tree), media_type="application/json", headers=HEADERS)


def text_of(tree: Any) -> str:
    """Compact JSON; a number that is none is a bug."""
    return json.dumps(tree, allow_nan=False, separators=(",", ":"))


def _page(path: Path) -> Callable[[Request], Response]:
    return lambda request: FileResponse(path, headers=HEADERS)


class _Shared:
    """One snapshot for all pages."""

    def __init__(self, source: PageSource, period_s: float) -> None:
        self._source, self._period_s = source, period_s
        self._quick = self._slow = ""
        self._taken_s = self._slow_s = float("-inf")

    def texts(self) -> tuple[str, str]:
        """Both parts as events, at most a period and a second old."""
        now_s = asyncio.get_running_loop().time()
        if now_s - self._taken_s >= 0.5 * self._period_s:
            self._taken_s = now_s
            self._quick = f"data: {text_of(self._source.snapshot())}\n\n"
        if now_s - self._slow_s >= SLOW_S:
            self._slow_s = now_s
            self._slow = f"event: slow\ndata: {text_of(self._source.slow())}\n\n"
        return self._quick, self._slow

    async def keep(self) -> None:
        """Go on while no page is open: the history has no holes."""
        while True:
            self.texts()
            await asyncio.sleep(self._period_s)


async def _stream(shared: _Shared, request: Request, period_s: float) -> AsyncIterator[str]:
    told = ""
    while not await request.is_disconnected():
        quick, slow = shared.texts()
        yield quick if slow == told else quick + slow
        told = slow
        await asyncio.sleep(period_s)


def listen(host: str, port: int) -> socket.socket:
    """The socket the page is served on.

    Raises:
        InputError: the port is in use or not permitted.
    """
    try:
        return socket.create_server((host, port))
    except OSError as error:
        reason = f"{host}:{port} cannot be used: {error.strerror}"
        raise InputError(f"dashboard: {reason}; set dashboard.port to another one") from None


def server_of(app: Starlette) -> uvicorn.Server:
    """The server of a page; a line for every request that is none would be a flood in its log."""
    settings = uvicorn.Config(app, http=Connection, log_level="error", lifespan="on", timeout_graceful_shutdown=1)
    return uvicorn.Server(settings)


def serve(app: Starlette, listener: socket.socket) -> None:
    """Serve until interrupted."""
    server = server_of(app)
    with suppress(KeyboardInterrupt):  # uvicorn has ended in order, and raises the signal again afterwards
        server.run(sockets=[listener])


MOST = 200
"""connections at once: a browser has one for each page, and up to six while it loads"""
ASKS_WITHIN_S = 10.0
"""from connecting to the whole of the first request"""


class Connection(H11Protocol):
    """HTTP as uvicorn speaks it, bounded: so many connections at once, and each must ask for something soon.

    Without an end to both, who only connects takes every file the process may open, and each further attempt is a
    traceback in the log.
    """

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        if len(self.connections) > MOST:
            transport.abort()
        else:
            asyncio.get_running_loop().call_later(ASKS_WITHIN_S, self._end_if_silent)

    def _end_if_silent(self) -> None:
        if self.cycle is None:
            self.transport.abort()

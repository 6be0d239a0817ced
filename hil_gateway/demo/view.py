"""What a person sees during the demo: the car on the track, and why the loop does what it does.

In a terminal a live page on standard error; elsewhere one plain line every `LINE_S`.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Container, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from hil_gateway.bus.messages import FailsafeAction, GatewayStatus
from hil_gateway.bus.topics import ESTIMATE, GATEWAY_STATUS
from hil_gateway.demo.canvas import Canvas
from hil_gateway.demo.monitor import Monitor
from hil_gateway.demo.referee import DriveReferee
from hil_gateway.gateway.check.arming import EXPLANATION
from hil_gateway.gateway.decide.failsafe import ROWS
from hil_gateway.process.figures import figure
from hil_gateway.track.track import Track

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.table import Table

LINE_S = 5.0
REFRESH_HZ = 8
MAP_POINTS = 1500
TABLE_COLUMNS = 44
"""characters one stack of tables needs"""
MAP_COLUMNS, MAP_ROWS = (26, 58), (10, 24)
"""smallest and largest map"""
SHORT = {"av24/gateway_status": "gateway", "av24/model_revision": "model"}
"""names of topics where room is scarce"""
COLOURS = {
    FailsafeAction.DRIVE: "green",
    FailsafeAction.SILENT: "yellow",
    FailsafeAction.CONTROLLED_STOP: "dark_orange",
    FailsafeAction.EMERGENCY_STOP: "red",
}


@dataclass(frozen=True)
class Scene:
    """Everything that is shown at one moment."""

    now_ns: int
    elapsed_s: float
    monitor: Monitor
    referee: DriveReferee
    cpu_share: Mapping[str, float]
    alive: Mapping[str, int]
    heading: str
    ending: bool = False
    """the gateway was asked to end: nothing is asked of a person any more"""

    @property
    def asks(self) -> bool:
        """Whether a person is told what is missing before the car drives."""
        status = self.monitor.status
        return status is not None and status.action is not FailsafeAction.DRIVE and not self.ending

    @property
    def gateway_lost(self) -> str:
        """Why nothing is known of the car any more, in words; empty while the gateway, the hub of the bus, talks."""
        age_s, alive = self.monitor.ages_s(self.now_ns)[GATEWAY_STATUS.key]
        if self.monitor.status is None or alive:
            return ""
        return f"no word of the gateway for {age_s:.1f} s" if "gateway" in self.alive else "the gateway has ended"


class View(Protocol):
    """Shows scenes; `say` is for what must not be missed."""

    def show(self, scene: Scene) -> None: ...
    def say(self, text: str) -> None: ...
    def close(self) -> None: ...


class PlainView:
    """Lines on standard error."""

    def __init__(self, period_s: float = LINE_S) -> None:
        self._period_ns, self._next_ns = int(period_s * 1e9), 0

    def show(self, scene: Scene) -> None:
        if scene.now_ns >= self._next_ns:
            self._next_ns = scene.now_ns + self._period_ns
            self.say(line(scene))

    def say(self, text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    def close(self) -> None:
        """Nothing to end."""


class LiveView:
    """A page that redraws itself, laid out for the size of the terminal."""

    def __init__(self, track: Track, console: Console | None = None) -> None:
        from rich.console import Console
        from rich.live import Live

        self._console, self._track = console or Console(stderr=True), track
        self._lay_out()
        self._live = Live(console=self._console, auto_refresh=False, vertical_overflow="crop")
        self._live.start()
        self._next_ns = 0

    def _lay_out(self) -> None:
        """The map for the size the terminal has now."""
        self._size, track = self._console.size, self._track
        columns, rows = self._size
        self._wide = columns >= MAP_COLUMNS[0] + 2 * TABLE_COLUMNS
        free = columns - (2 if self._wide else 1) * TABLE_COLUMNS
        step = max(len(track.x) // MAP_POINTS, 1)
        self._canvas = Canvas(
            track.x[::step].tolist(), track.y[::step].tolist(), _within(free, MAP_COLUMNS), _within(rows - 5, MAP_ROWS)
        )
        self._map = "\n".join(self._canvas.lines())

    def show(self, scene: Scene) -> None:
        if scene.now_ns >= self._next_ns:
            self._next_ns = scene.now_ns + int(1e9 / REFRESH_HZ)
            self._live.update(self.page(scene), refresh=True)

    def say(self, text: str) -> None:
        self._console.print(text, highlight=False, markup=False)

    def close(self) -> None:
        self._live.stop()

    def page(self, scene: Scene) -> RenderableType:
        """The whole page: map, car and belief, and on a wide terminal also the loop and its processes."""
        from rich.console import Group
        from rich.panel import Panel
        from rich.table import Table

        if self._console.size != self._size:
            self._lay_out()
        stacks = [Group(_car_table(scene), _belief_table(scene))]
        if self._wide:
            stacks.append(Group(_loop_table(scene), _process_table(scene)))
        grid = Table.grid(padding=(0, 2))
        grid.add_row(Panel.fit(self._draw_map(scene), title=scene.heading), *stacks)
        return Group(_headline(scene), grid, *(() if self._wide else (_ages_line(scene),)))

    def _draw_map(self, scene: Scene) -> RenderableType:
        from rich.text import Text

        text = Text(self._map, style="grey62", no_wrap=True)
        where = scene.monitor.estimate or scene.referee.truth
        if where is not None and math.isfinite(where.x):
            cell = self._canvas.cell(where.x, where.y)
            start = cell.row * (self._canvas.width + 1) + cell.column
            text = Text.assemble(text[:start], ("●", "bold red"), text[start + 1 :])
        return text


def _within(value: int, bounds: tuple[int, int]) -> int:
    return min(max(value, bounds[0]), bounds[1])


def _headline(scene: Scene) -> RenderableType:
    from rich.text import Text

    status = scene.monitor.status
    if status is None:
        return Text(" waiting for the gateway", style="yellow")
    if scene.gateway_lost:
        return Text(f" {scene.gateway_lost} ", style="bold reverse red")
    text = Text(f" {status.action.value.upper()} ", style=f"bold reverse {COLOURS[status.action]}")
    text.append(f"  {status.cause}" if status.cause else "", style="reset")
    text.append(f"  {before_arming(status, scene.alive)}" if scene.asks else "", style="reset yellow")
    return text


def before_arming(status: GatewayStatus, running: Container[str]) -> str:
    """What is still needed, in words: the first, and how many more; no process of those `running` is to be started."""
    missing = status.missing_for_arming
    if not missing:
        return "ready: `hil gateway arm`"
    more = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
    awaited = "not armed yet" if status.action is FailsafeAction.SILENT else "before it drives again"
    return f"{awaited}: {status.advice.get(missing[0]) or _explained(missing[0], running)}{more}"


def _explained(cause: str, running: Container[str]) -> str:
    row = ROWS.get(cause)
    return row.meaning if row is not None and row.awaits in running else EXPLANATION.get(cause, cause)


def _table(title: str, *columns: str) -> Table:
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False, padding=(0, 1))
    for number, column in enumerate(columns):
        table.add_column(column, justify="left" if number == 0 else "right", no_wrap=True, header_style="dim")
    return table


def _car_table(scene: Scene) -> Table:
    estimate, plan, referee = scene.monitor.estimate, scene.monitor.plan, scene.referee
    table = _table("car", "", "")
    table.show_header = False
    if estimate and not scene.gateway_lost:
        table.add_row("speed", f"{estimate.vx:6.1f} m/s  {3.6 * estimate.vx:4.0f} km/h")
        table.add_row("steering", f"{math.degrees(estimate.steer):+6.2f} deg at the wheel")
        table.add_row("drive", f"{estimate.drive:+7.4f} slip")
    table.add_row("laps", f"{referee.laps}   {'  '.join(f'{t:.2f} s' for t in referee.lap_times_s[-3:])}")
    table.add_row("off track", str(referee.off_track))
    if plan:
        table.add_row("plan", f"{plan.solve_ms:5.1f} ms  {plan.status.value}  {plan.reason}".rstrip())
    return table


def _belief_table(scene: Scene) -> Table:
    belief, prior = scene.monitor.belief, scene.monitor.prior
    table = _table("tyre belief", "", "mean", "std", "change")
    if belief and prior:
        spread = np.sqrt(np.clip(np.diag(np.asarray(belief.covariance)), 0.0, None))
        for name, mean, std, start in zip(belief.names, belief.mean, spread, prior.mean, strict=True):
            change = f"{100 * (mean / start - 1):+6.1f} %" if start else ""
            table.add_row(name, figure(mean), figure(std, digits=3), change)
    return table


def _loop_table(scene: Scene) -> Table:
    status, recorder = scene.monitor.status, scene.monitor.recorder
    table = _table("loop", "message", "age", "")
    for key, (age_s, alive) in scene.monitor.ages_s(scene.now_ns).items():
        age = "never" if math.isinf(age_s) else f"{1e3 * age_s:5.0f} ms"
        table.add_row(key.removeprefix("av24/"), age, "[green]ok[/]" if alive else "[red]old[/]")
    if status and status.loop_latency_p50_ms is not None:
        table.add_row("latency p50, p99", f"{status.loop_latency_p50_ms:.1f}", f"{status.loop_latency_p99_ms:.1f} ms")
    if recorder:
        table.add_row("recorded", f"{recorder.bytes_written / 1e6:.1f} MB", f"{recorder.lost} lost")
    return table


def _ages_line(scene: Scene) -> RenderableType:
    """Message ages where there is no room for their table."""
    from rich.text import Text

    text = Text(" ms old: ", style="dim")
    for key, (age_s, alive) in scene.monitor.ages_s(scene.now_ns).items():
        age = "never" if math.isinf(age_s) else f"{1e3 * age_s:.0f}"
        text.append(f"{SHORT.get(key, key.removeprefix('av24/'))} {age}  ", style="reset" if alive else "red")
    return text


def _process_table(scene: Scene) -> Table:
    table = _table("processes", "", "pid", "CPU")
    for name, share in scene.cpu_share.items():
        pid = scene.alive.get(name)
        table.add_row(name, str(pid) if pid else "[red]ended[/]", f"{100 * share:.0f} %")
    return table


def line(scene: Scene) -> str:
    """The scene in one line."""
    status, estimate, plan, referee = scene.monitor.status, scene.monitor.estimate, scene.monitor.plan, scene.referee
    parts = [f"{scene.elapsed_s:6.1f} s"]
    if scene.gateway_lost:
        return "  ".join([*parts, scene.gateway_lost])
    parts.append(status.action.value if status else "waiting for the gateway")
    if status and status.cause:
        parts.append(f"({status.cause})")
    if status and scene.asks:
        parts.append(before_arming(status, scene.alive))
    if estimate and scene.monitor.ages_s(scene.now_ns)[ESTIMATE.key][1]:
        parts.append(f"{estimate.vx:z5.1f} m/s, steering {math.degrees(estimate.steer):+5.1f} deg")
    if plan:
        parts.append(f"plan {plan.solve_ms:.0f} ms")
    if referee.truth:
        parts.append(f"lap {referee.laps + 1}, {referee.distance_m:.0f} m, off track {referee.off_track}")
    return "  ".join(parts)

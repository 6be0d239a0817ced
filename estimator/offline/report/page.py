"""Self-contained HTML reports: one file, no network, figures inline, readable on screen and on paper.

Used by identification, diagnosis and campaigns. Build a `ReportPage` from top to bottom, then `write` it.
"""

from __future__ import annotations

import base64
import datetime as dt
import io
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import jinja2

from hil_gateway.car.vehicle import Vehicle
from hil_gateway.dashboard.look import light_colours, look
from hil_gateway.session.files.format import software_version

Tone = Literal["good", "warn", "bad", "neutral"]

_LIGHT = light_colours()
COLOURS = {
    "measured": _LIGHT["text"],
    "before": _LIGHT["bad"],
    "after": _LIGHT["accent"],
    "accent": _LIGHT["warn"],
    "muted": _LIGHT["edge"],
    "extra": _LIGHT["good"],
}
"""One meaning, one colour, in every figure; the colours of the pages."""

STATED = ("mass", "yaw_inertia", "lf", "lr", "cg_height", "wheel_radius", "steering_ratio")
"""what of the declared vehicle every report names"""

MAX_SVG_BYTES = 300_000
"""Figures that would be larger as SVG are stored as PNG."""

_STYLE = {
    "figure.dpi": 100,
    "font.size": 9.5,
    "font.family": "DejaVu Sans",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": _LIGHT["edge"],
    "axes.labelcolor": _LIGHT["text"],
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.grid": True,
    "grid.color": _LIGHT["line"],
    "grid.linewidth": 0.7,
    "legend.frameon": False,
    "xtick.color": _LIGHT["quiet"],
    "ytick.color": _LIGHT["quiet"],
    "lines.linewidth": 1.3,
    "svg.fonttype": "path",
    "svg.hashsalt": "report",
}


def plot_style() -> AbstractContextManager[None]:
    """Matplotlib settings all figures of a report share; use as a context manager around plotting."""
    import matplotlib as mpl

    return mpl.rc_context(_STYLE)


def new_figure(
    rows: int = 1, columns: int = 1, size: tuple[float, float] = (9.0, 3.2), **options: Any
) -> tuple[Any, Any]:
    """A figure and its axes without any global state; `size` in inches, `options` as for `Figure.subplots`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


def inline_image(figure: Any) -> str:
    """The figure as an HTML fragment: SVG, or PNG where that would be large."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    svg = buffer.getvalue()
    if len(svg) <= MAX_SVG_BYTES:
        return svg[svg.index("<svg") :]
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=160)
    return f'<img alt="" src="data:image/png;base64,{base64.b64encode(picture.getvalue()).decode()}">'


@dataclass(frozen=True)
class _Block:
    kind: str
    content: dict[str, Any]


@dataclass
class ReportPage:
    """A page: title, one-sentence verdict, then sections of text, tables and figures in the order they are added."""

    title: str
    subtitle: str = ""
    progress: Callable[[str], None] = lambda _: None
    """called with the title of every section that begins"""
    _blocks: list[_Block] = field(default_factory=list)

    def verdict(self, sentence: str, tone: Tone = "neutral") -> None:
        """The result in a sentence, set large."""
        self._add("verdict", sentence=sentence, tone=tone)

    def section(self, title: str, lead: str = "") -> None:
        """Start a section."""
        self.progress(title)
        self._add("section", title=title, lead=lead)

    def text(self, paragraph: str) -> None:
        """One paragraph of plain text."""
        self._add("text", paragraph=paragraph)

    def items(self, lines: Sequence[str]) -> None:
        """A list of plain-text lines; nothing where there are none."""
        if lines:
            self._add("items", lines=list(lines))

    def tiles(self, values: Sequence[tuple[str, str, str]]) -> None:
        """Key figures side by side: (label, value, remark)."""
        self._add("tiles", values=list(values))

    def table(self, header: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> None:
        """A table of text cells; the first column is left-aligned, the others right-aligned."""
        self._add("table", header=list(header), rows=[list(row) for row in rows], caption=caption)

    def figure(self, figure: Any, caption: str) -> None:
        """A matplotlib figure with a caption that says what to see in it."""
        self._add("figure", image=inline_image(figure), caption=caption)

    def details(self, summary: str, lines: Sequence[str]) -> None:
        """Lines folded away behind a summary."""
        if lines:
            self._add("details", summary=summary, lines=list(lines))

    def made_with(self, vehicle: Vehicle) -> None:
        """Day, version of the software and the declared car: what a reader needs to make the page again."""
        today = dt.datetime.now(dt.UTC).date().isoformat()
        stated = ", ".join(f"{name} {getattr(vehicle, name):g}" for name in STATED)
        self.items([f"made on {today} by hil-gateway {software_version()}", f"declared vehicle: {stated} (SI)"])

    def html(self) -> str:
        """The whole page."""
        loader = jinja2.FileSystemLoader(Path(__file__).parent / "templates")
        environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
        return environment.get_template("report.html").render(report=self, blocks=self._blocks, look=look())

    def write(self, path: Path) -> Path:
        """Write the page and return its path."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(self.html(), encoding="utf-8")
        return path

    def _add(self, kind: str, **content: Any) -> None:
        self._blocks.append(_Block(kind, content))

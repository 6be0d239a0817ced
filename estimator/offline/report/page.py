"""Self-contained HTML reports: one file, no network, figures inline, readable on screen and on paper.

Used by identification, diagnosis and campaigns. Build a `ReportPage` from top to bottom, then `write` it.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import jinja2

from hil_gateway.car.vehicle import Vehicle
from hil_gateway.dashboard.look import inline_image, look
from hil_gateway.session.files.format import software_version

Tone = Literal["good", "warn", "bad", "neutral"]

STATED = ("mass", "yaw_inertia", "lf", "lr", "cg_height", "wheel_radius", "steering_ratio")
"""what of the declared vehicle every report names"""


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

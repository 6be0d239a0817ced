"""The look that all pages share, and figures in it: inline, without global state. `page/look.css` owns the colours."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Mapping
from contextlib import AbstractContextManager
from functools import cache
from typing import Any

from hil_gateway.process.shipped import shipped

_COLOUR = re.compile(r"--([a-z-]+):\s*(#[0-9a-f]{6})")


@cache
def look() -> str:
    """The shared stylesheet, to be put into a page that stands alone."""
    return shipped("hil_gateway", "dashboard/page/look.css").read_text()


@cache
def light_colours() -> Mapping[str, str]:
    """Name -> #rrggbb of the light theme, for figures on white paper."""
    light = look().split(':root[data-theme="light"]', 1)[1].split("}", 1)[0]
    return dict(_COLOUR.findall(light))


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

"""A season as one self-contained HTML page: what changed, what was new then, and every quantity by session."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from hil_gateway.dashboard.day.page import date, section, table, text, whole_page
from hil_gateway.dashboard.look import COLOURS, inline_image, new_figure, plot_style
from hil_gateway.process.figures import figure

ROW_INCHES, WIDE_INCHES = 1.9, 11.0
SET_COLOURS = (*(COLOURS[name] for name in ("after", "before", "extra", "accent", "measured")), COLOURS["muted"])
"""of tyre sets, in the order in which they first appear; the last is that of all others"""


def page(season: dict[str, Any], sessions: Sequence[dict[str, Any]]) -> str:
    """HTML of a season (`hil_gateway.session.day.season.season`) with the sessions it was made of."""
    number = {s["number"]: s for s in sessions}
    series = sorted(season["series"], key=lambda row: not row["steps"])
    unread = [f"<p>not readable: {text(name)}</p>" for name in season["unreadable"]]
    parts = [
        section("What changed", _changes(season["changes"], number) + "".join(unread)),
        section("Every quantity", _quantities(series)),
        section("Session by session", _charts(series, number)),
    ]
    days = f"{date(sessions[0])} to {date(sessions[-1])}"
    return whole_page(f"Season, {days}, {season['sessions']} sessions", parts)


def _changes(changes: Sequence[dict[str, Any]], number: dict[int, dict[str, Any]]) -> str:
    if not changes:
        return "<p>Nothing steps from one session to the next by more than chance does.</p>"
    rows = [
        (
            f"{date(number[change['session']])}, session {change['session']}, {number[change['session']]['file']}",
            "; ".join(
                f"{one['name']} {_value(one['before'], one)} to {_value(one['after'], one)}" for one in change["moved"]
            ),
            "; ".join(change["new"]) or "nothing noted",
        )
        for change in changes
    ]
    return table(("from", "what stepped", "new then"), rows)


def _quantities(series: Sequence[dict[str, Any]]) -> str:
    rows = [
        (
            one["name"], str(len(one["value"])), _value(float(np.median(one["value"])), one),
            "steps" if one["steps"] else "" if one["drift"] is None else f"{_value(100 * one['drift'], one)}",
            "" if one["per_10_c"] is None else _value(one["per_10_c"], one),
            ", ".join(f"{name} {_value(value, one)}" for name, value in one["tyres"].items()),
        )
        for one in series
    ]  # fmt: skip
    return table(("", "sessions", "median", "drift in 100 sessions", "for 10 deg C more", "by tyre set"), rows)


def _charts(series: Sequence[dict[str, Any]], number: dict[int, dict[str, Any]]) -> str:
    sets = list(dict.fromkeys(_tyres(s) for s in number.values()))
    colours = dict(zip(sets, SET_COLOURS, strict=False))
    with plot_style():
        drawn, axes = new_figure(len(series), 1, (WIDE_INCHES, ROW_INCHES * len(series)), squeeze=False, sharex=True)
        for axis, one in zip(axes[:, 0], series, strict=True):
            _chart(axis, one, [colours.get(_tyres(number[n]), SET_COLOURS[-1]) for n in one["session"]])
        _name_days(axes[-1, 0], number)
        legend = ", ".join(_coloured(name or "not named", colour) for name, colour in colours.items())
        return (
            f"<p>Bars: stated deviation. Lines: medians between changes. Tyre sets: {legend}</p>{inline_image(drawn)}"
        )


def _chart(axis: Any, one: dict[str, Any], colours: list[str]) -> None:
    at, value = np.array(one["session"]), np.array(one["value"])
    std = np.array([np.nan if deviation is None else deviation for deviation in one["std"]])
    axis.vlines(at, value - std, value + std, colors=colours, linewidth=0.8, alpha=0.5)
    axis.scatter(at, value, s=9, c=colours, zorder=3)
    edges = [at[0], *(step["session"] for step in one["steps"]), at[-1] + 1]
    for begin, end in pairwise(edges):
        median = float(np.median(value[(at >= begin) & (at < end)]))
        axis.hlines(median, begin - 0.5, end - 0.5, colors=COLOURS["measured"], linewidth=1.4)
    for step in one["steps"]:
        axis.axvline(step["session"] - 0.5, color=COLOURS["before"], linestyle="--", linewidth=1.0)
    axis.set_title(f"{one['name']}{', ' + one['unit'] if one['unit'] else ''}")


def _name_days(axis: Any, number: dict[int, dict[str, Any]]) -> None:
    """A date below the first session of a day, as many as there is room for."""
    first: dict[str, int] = {}
    for n, s in number.items():
        first.setdefault(date(s), n)
    shown = list(first.items())[:: 1 + len(first) // 12]
    axis.set_xticks([n for _, n in shown], [f"{dt.date.fromisoformat(day):%d %b}\n{n}" for day, n in shown])
    axis.set_xlabel("day and number of its first session")


def _tyres(s: dict[str, Any]) -> str:
    return ", ".join(s.get("tyres") or [])


def _coloured(name: str, colour: str) -> str:
    return f'<b style="color:{colour}">{text(name)}</b>'


def _value(value: float, one: dict[str, Any]) -> str:
    return figure(value, one["unit"], 4)

"""A day at the track as one self-contained HTML page: nothing is loaded from anywhere."""

from __future__ import annotations

import datetime as dt
import html
import math
from collections.abc import Iterable, Sequence
from typing import Any

from hil_gateway.dashboard.look import look
from hil_gateway.dashboard.server import FOLDER as PAGE
from hil_gateway.process.figures import figure, lap_time
from hil_gateway.session.overview.info import marked, note_words

LAYOUT = """main { display: block; max-width: 84rem; margin: 0 auto; }
section { margin-bottom: .7rem; overflow-x: auto; }
h2.session { font-size: 1.05rem; text-transform: none; color: var(--text); }
h3 { margin: .8rem 0 .2rem; font-size: .9rem; }
svg, img { max-width: 100%; height: auto; }
th, td { text-align: left; padding-right: 1rem; vertical-align: top; white-space: normal; }
"""
Row = Sequence[str]


def page(day: dict[str, Any]) -> str:
    """HTML of a day (`hil_gateway.session.day.index.read_day`)."""
    sessions = day["sessions"]
    parts = [_overview(sessions), _sectors(sessions), _tyre_sets(day["tyres"]), *(_session(one) for one in sessions)]
    return whole_page(f"Day at the track, {date(sessions[0])}", parts)


def whole_page(title: str, parts: Iterable[str]) -> str:
    """HTML of a page that stands alone."""
    style = look() + (PAGE / "style.css").read_text() + LAYOUT
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{text(title)}</title>'
    return (
        f'<!doctype html><html lang="en" data-theme="light"><head>{head}<style>{style}</style></head>'
        f"<body><header><h1>{title}</h1></header><main>{''.join(parts)}</main></body></html>\n"
    )


def _overview(sessions: list[dict[str, Any]]) -> str:
    best = min((s["best_lap_s"] for s in sessions if s.get("best_lap_s")), default=None)
    rows: list[Row] = []
    for s in sessions:
        if reason := s.get("unreadable"):
            rows.append((str(s["number"]), s["file"], f"not readable: {reason}", "", "", "", "", "", ""))
            continue
        stops = ", ".join(dict.fromkeys(stop["cause"] for stop in s["stops"])) or "none"
        rows.append((
            str(s["number"]), s["file"], _clock(s, 0.0), figure(s["duration_s"], "s", 4), str(len(s["laps"])),
            lap_time(s["best_lap_s"]) + (" (best of the day)" if s["best_lap_s"] == best and best else ""),
            figure(s["km"], "km", 3), stops, ", ".join(s["effects"]) or "none",
        ))  # fmt: skip
    names = ("session", "recording", "began", "recorded", "laps", "best lap", "driven", "stops", "effects in the model")
    return section("The day", table(names, rows))


def _sectors(sessions: list[dict[str, Any]]) -> str:
    """The quickest of each sector, of laps without a mark; one table a track."""
    out = []
    for track in dict.fromkeys(s["track"] for s in sessions if "track" in s):
        laps = [
            (s["number"], n, lap)
            for s in sessions
            if s.get("track") == track
            for n, lap in enumerate(s["laps"], start=1)
            if not lap["marks"]
        ]
        if not laps:
            continue
        times = [[(sector, f"{s}.{n}") for sector in lap["sectors_s"]] for s, n, lap in laps]
        fastest = [min(sector) for sector in zip(*times, strict=True)]
        rows = [(f"sector {i}", lap_time(time), lap) for i, (time, lap) in enumerate(fastest, start=1)]
        ideal = sum(time for time, _ in fastest)
        out.append(
            section(f"Best sectors, {track}", table(("", "time", "lap"), [*rows, ("together", lap_time(ideal), "")]))
        )
    return "".join(out)


def _tyre_sets(sets: dict[str, dict[str, float]]) -> str:
    rows = [(name or "not named", f"{used['laps']:g}", figure(used["km"], "km", 4)) for name, used in sets.items()]
    return section("Tyre sets", table(("set", "laps", "driven"), rows))


def _session(s: dict[str, Any]) -> str:
    title = f"Session {s['number']}: {s['file']}"
    if "unreadable" in s:
        return section(title, f"<p>not readable: {text(s['unreadable'])}</p>", big=True)
    about = f"{s['car']} on {s['track']}, {s['software']}, fastest {figure(s['top_speed'], 'm/s', 3)}"
    about += f"; {s['lost']} frames and messages not recorded"
    gaps = [f"{_clock(s, g['t'])}: nothing recorded for {g['seconds']:.1f} s, before {g['before']}" for g in s["gaps"]]
    whole = [] if s["complete"] else ["not closed in order: readable up to its last whole chunk"]
    parts = [
        items([about, *gaps, *whole, *s["damage"]]),
        _part("Runs", ("run", "began", "driven", "laps asked", "tyres", "fuel", "caps", "ended", "notes"), _runs(s)),
        _part("Laps", ("lap", "began", "time", "sectors", "run", "tyres", "marks"), _laps(s)),
        _part("Stops", ("time", "where", "what", "cause", "measured", "drove again after"), _stops(s)),
        _part("What else happened", ("time", "what"), [(_clock(s, e["t"]), _event(e)) for e in s["happened"]]),
        _part("Notes", ("time", "note"), [(_clock(s, n["t"]), note_words(n)) for n in s["remarks"]]),
        _part("Model", ("time", "revision", "effects and their parameters", "error before and after"), _models(s)),
        _part("Tyres as believed at the end", ("parameter", "mean", "deviation"), _believed(s)),
        _part("Not explained by the model", ("channels", "where", "times its noise", "suspected"), _alerts(s)),
    ]
    return section(title, "".join(parts), big=True)


def _runs(s: dict[str, Any]) -> list[Row]:
    rows: list[Row] = []
    for run in s["runs"]:
        caps = [f"{cap:g} m/s" for cap in run["speed_caps"]] + [
            f"{100 * cap:.0f} % of the grip" for cap in run["load_caps"]
        ]
        fuel = "" if run["fuel_kg"] is None else figure(run["fuel_kg"], "kg", 3)
        ended = f"{run['phase']}: {run['said']}" if run["said"] else run["phase"]
        ended += f"; {_parked(run['parked'])}" if run["parked"] else ""
        why = f"{', '.join(caps) or 'none'} ({run['caps_from']})"
        way, time = figure(run["km"], "km", 3), figure(run["seconds"], "s", 3)
        driven = f"{way} in {time}, at most {figure(run['top_speed'], 'm/s', 3)}"
        named, began = f"{run['number']} {run['name']}", _clock(s, run["t"])
        rows.append((named, began, driven, str(run["asked_laps"]), run["tyres"], fuel, why, ended, run["notes"]))
    return rows


def _parked(parked: dict[str, float]) -> str:
    """How the car stands in its box, by its own estimate."""
    along, across, turned = parked["ahead_m"], parked["left_m"], math.degrees(parked["turned_rad"])
    place = f"{abs(along):.2f} m {'beyond' if along > 0 else 'short'}, {abs(across):.2f} m {_side(across)}"
    return f"in box {parked['box']:.0f}: {place}, turned {abs(turned):.1f} deg {_side(turned)}"


def _side(left: float) -> str:
    return "left" if left > 0 else "right"


def _laps(s: dict[str, Any]) -> list[Row]:
    rows: list[Row] = []
    for n, lap in enumerate(s["laps"], start=1):
        sectors = "  ".join(f"{sector:.2f}" for sector in lap["sectors_s"])
        best = "best" if lap["time_s"] == s["best_lap_s"] and not lap["marks"] else ""
        run = str(lap["run"] or "")
        mark = marked(lap).removeprefix(", ") or best
        rows.append(
            (f"{s['number']}.{n}", _clock(s, lap["start_s"]), lap_time(lap["time_s"]), sectors, run, lap["tyres"], mark)
        )
    return rows


def _stops(s: dict[str, Any]) -> list[Row]:
    rows: list[Row] = []
    for stop in s["stops"]:
        measured = stop.get("measured")
        shown = "" if measured is None else figure(measured, stop["unit"], 3)
        limit = "" if stop.get("limit") is None else f", limit {figure(stop['limit'], stop['unit'], 3)}"
        cause = f"{stop['cause']}: {stop['text']}" if stop.get("text") else stop["cause"]
        what, again = stop["after"].replace("_", " "), figure(stop.get("again_s"), "s", 3)
        rows.append((_clock(s, stop["t"]), _where(s, stop), what, cause, shown + limit, again))
    return rows


def _where(s: dict[str, Any], stop: dict[str, Any]) -> str:
    """Where on the track, in which lap and run."""
    if stop.get("place_m") is None:
        return ""
    run = f", run {stop['run']}" if stop["run"] else ""
    return f"lap {s['number']}.{stop['lap']} at {stop['place_m']:.0f} m{run}"


def _event(event: dict[str, Any]) -> str:
    change = f"{event['before']} to {event['after']}" if event["before"] else event["after"]
    return f"{event['text']}: {change}".replace("_", " ")


def _models(s: dict[str, Any]) -> list[Row]:
    """Where the list of effects changed, and the last one: refinements of tyres in between are many."""
    rows: list[Row] = []
    before = None
    for row in s["revisions"]:
        if row["effects"] != before or row is s["revisions"][-1]:
            effects = "; ".join(
                f"{name}: {', '.join(f'{p} {figure(v)}' for p, v in numbers.items())}"
                for name, numbers in row["parameters"].items()
            )
            errors = ", ".join(
                f"{n} {figure(b, digits=3)} to {figure(a, digits=3)}" for n, (b, a) in row["errors"].items()
            )
            rows.append((_clock(s, row["t"]), row["revision"], effects or "none added", errors))
        before = row["effects"]
    return rows


def _believed(s: dict[str, Any]) -> list[Row]:
    return [
        (f"{row['name']}{', ' + row['unit'] if row['unit'] else ''}", figure(row["mean"]), figure(row["std"], digits=2))
        for row in s["tyres_believed"]
    ]


def _alerts(s: dict[str, Any]) -> list[Row]:
    return [
        (", ".join(a["channels"]), "; ".join(a["conditions"]), figure(a["strength"], "", 3), a["suspect"])
        for a in s["alerts"]
    ]


def _part(title: str, names: Row, rows: list[Row]) -> str:
    if not rows:
        return f'<h3>{title}</h3><p class="quiet">none</p>'
    return f"<h3>{title}</h3>{table(names, rows)}"


def table(names: Row, rows: Iterable[Row]) -> str:
    head = "".join(f"<th>{text(name)}</th>" for name in names)
    body = "".join(f"<tr>{''.join(f'<td>{text(cell)}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def items(lines: Iterable[str]) -> str:
    return f"<ul>{''.join(f'<li>{text(line)}</li>' for line in lines)}</ul>"


def section(title: str, content: str, big: bool = False) -> str:
    kind = ' class="session"' if big else ""
    return f"<section><h2{kind}>{text(title)}</h2>{content}</section>"


def text(value: str) -> str:
    return html.escape(value)


def _at(s: dict[str, Any], t_s: float) -> dt.datetime:
    return dt.datetime.fromtimestamp((s.get("start_unix_s") or 0.0) + t_s, dt.UTC)


def _clock(s: dict[str, Any], t_s: float) -> str:
    """Time of day, UTC: the page is the same wherever it is opened."""
    return f"{_at(s, t_s):%H:%M:%S}"


def date(s: dict[str, Any]) -> str:
    return f"{_at(s, 0.0):%Y-%m-%d}"

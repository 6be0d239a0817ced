"""Results of the laboratory: `benchmarks/results/AREA.json` is what runs wrote, `docs/results/AREA.md` the page of it.

    python -m benchmarks.results AREA HEADING FILE COMMAND...

puts the newest run of a command under its heading, in the place of the one before, and writes the page anew. FILE is
what the command wrote as JSON: `summary.json` of `hil campaign laps` or `cars`, the report of `hil verify
--fault-survey --json`, that of `benchmarks.faults.least_noticed`, or the cases of `benchmarks.diagnosis.diagnose
--json`. Without arguments the pages are written anew.
"""

from __future__ import annotations

import json
import math
import shlex
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.campaign.laps import commit
from hil_gateway.process.errors import InputError
from hil_gateway.process.model import Model
from hil_gateway.text_file import read_text

ROOT = Path(__file__).resolve().parents[1]

Rows = tuple[tuple[str, ...], ...]


class Table(Model):
    """One run: how it is made again, and what came out."""

    heading: str
    command: str
    commit: str
    columns: tuple[str, ...]
    rows: Rows
    note: str = ""
    """what the figures do not say by themselves, in one or two sentences"""


class Page(Model):
    """One area of results."""

    title: str
    reader: str
    asked: str
    tables: tuple[Table, ...]

    def markdown(self) -> str:
        """The page; runs of one line each and the same columns share a table."""
        alike = len({table.columns for table in self.tables}) == 1 and all(
            len(table.rows) == 1 for table in self.tables
        )
        body = [_together(self.tables)] if alike and len(self.tables) > 1 else list(map(_section, self.tables))
        return "\n".join([f"# {self.title}", "", self.reader, "", self.asked, "", *body])


def _section(table: Table) -> str:
    head = [f"## {table.heading}", "", f"`{table.command}`, commit {table.commit}.", ""]
    return "\n".join([*head, *_grid(table.columns, table.rows), "", *([table.note, ""] if table.note else [])])


def _together(tables: Sequence[Table]) -> str:
    noted = ("note",) if any(table.note for table in tables) else ()
    rows = [(f"`{t.command}`", t.commit, *t.rows[0], *([t.note] if noted else [])) for t in tables]
    return "\n".join([*_grid(("command", "commit", *tables[0].columns, *noted), rows), ""])


def _grid(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return ["| " + " | ".join(row) + " |" for row in [columns, ("---",) * len(columns), *rows]]


def fault_rows(report: dict[str, Any]) -> tuple[tuple[str, ...], Rows]:
    """Of a survey: stops that keep to the road."""
    columns = ("stops", "off the road", "by physics", "unnoticed", "kept", "by track", "pairs kept", "without a fault")
    single, pairs, healthy = report["all"]["single"], report["all"]["pairs"], report["without a fault"]
    off, physics = len(single["stops off the road"]), single["off the road by physics"]
    unnoticed = len(single["off the road unnoticed"]) + len(pairs["off the road unnoticed"])
    tracks = ", ".join(f"{Path(t).stem} {_percent(found['single']['kept'])}" for t, found in report["tracks"].items())
    kept, both = _percent(single["kept"]), f"{_percent(pairs['kept'])} of {pairs['stops']}"
    false = f"{healthy['false stops']} of {healthy['places']}"
    return columns, ((*map(str, (single["stops"], off, physics, unnoticed)), kept, tracks, both, false),)


def least_rows(places: Sequence[dict[str, Any]]) -> tuple[tuple[str, ...], Rows]:
    """Of every error at every place the least size that is noticed: an error a row."""
    columns = ("error", "noticed at every place from", "at half of them from", "after, median", "mostly by")
    by_error: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for place in places:
        by_error.setdefault((place["source"], place["unit"]), []).append(place)

    def row(source: str, unit: str, of: Sequence[dict[str, Any]]) -> tuple[str, ...]:
        found = [place for place in of if place["size"] is not None]
        sizes = sorted([place["size"] for place in found] + [math.inf] * (len(of) - len(found)))
        named = (f"{size:.2g} {unit}" if math.isfinite(size) else "-" for size in (sizes[-1], sizes[len(of) // 2]))
        causes = Counter(place["cause"] for place in found).most_common(1)
        after = f"{median(place['after_s'] for place in found):.2f} s" if found else "-"
        return source, *named, after, causes[0][0] if causes else "-"

    return columns, tuple(row(*error, of) for error, of in by_error.items())


def lap_rows(summary: dict[str, Any]) -> tuple[tuple[str, ...], Rows]:
    """Of a campaign: lap time over the car's own limit, a car a row."""
    columns = ("car", "track", "lap 1", "lap 3", "last lap", "second session", "off the road, spins")

    def row(car: dict[str, Any]) -> tuple[str, ...]:
        ratios = car["lap_ratio"]
        laps = (ratios[i] if len(ratios) > i else None for i in (0, 2, len(ratios) - 1))
        again = car["second_session_lap_ratio"]
        return (
            str(car["seed"]),
            car["track"],
            *map(_ratio, laps),
            _ratio(again),
            f"{car['off_track']}, {car['spins']}",
        )

    return columns, tuple(row(car) for car in summary["cars"])


def car_rows(summary: dict[str, Any]) -> tuple[tuple[str, ...], Rows]:
    """Of named cars: how many drive all laps on the road and unstopped, a track a row."""
    columns = ("track", "drives", "all laps on the road", "stopped", "off the road", "least distance to the edge")

    def row(name: str, drives: Sequence[dict[str, Any]]) -> tuple[str, ...]:
        kept = sum(d["arrived"] and not d["stopped"] and not d["off_track"] for d in drives)
        stopped, off = (sum(bool(d[key]) for d in drives) for key in ("stopped", "off_track"))
        least = min(d["worst_margin_m"] for d in drives)
        return (name, *map(str, (len(drives), kept, stopped, off)), f"{least:.2f} m")

    by_track: dict[str, list[dict[str, Any]]] = {}
    for drive in summary["drives"]:
        by_track.setdefault(drive["track"], []).append(drive)
    return columns, (*(row(name, drives) for name, drives in by_track.items()), row("all", summary["drives"]))


def diagnosis_rows(cases: Sequence[dict[str, Any]]) -> tuple[tuple[str, ...], Rows]:
    """Of a list of drives: how many are right, and what is named that is not there."""
    columns = ("drives", "right", "named alone", "names that are not there")
    right, alone = (sum(bool(case[key]) for case in cases) for key in ("right", "alone"))
    false = sum(len(case["not_there"]) for case in cases)
    return columns, ((str(len(cases)), str(right), str(alone), str(false)),)


READERS: dict[str, Callable[[Any], tuple[tuple[str, ...], Rows]]] = {
    "faults": fault_rows,
    "least": least_rows,
    "laps": lap_rows,
    "effects": car_rows,
    "diagnosis": diagnosis_rows,
}
"""area -> rows of what its command writes"""


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"


def _ratio(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def load(area: str) -> Page:
    """What is kept of an area."""
    return Page.model_validate_json((ROOT / "benchmarks" / "results" / f"{area}.json").read_text())


def keep(area: str, heading: str, report: Any, command: str) -> Page:
    """The page with a run in the place of the one before it."""
    before = load(area)
    columns, rows = READERS[area](report)
    new = Table(heading=heading, command=command, commit=commit(), columns=columns, rows=rows)
    tables = [table for table in before.tables if table.heading != heading]
    return before.model_copy(update={"tables": (*tables, new)})


def write(area: str, page: Page) -> None:
    """JSON and page."""
    (ROOT / "benchmarks" / "results" / f"{area}.json").write_text(page.model_dump_json(indent=1) + "\n")
    (ROOT / "docs" / "results" / f"{area}.md").write_text(page.markdown())


def main(arguments: Sequence[str]) -> None:
    """Keep a run, or write the pages anew."""
    if not arguments:
        for area in READERS:
            write(area, load(area))
        return
    if len(arguments) < 4 or arguments[0] not in READERS:
        raise InputError(f"usage: python -m benchmarks.results {'|'.join(READERS)} HEADING FILE COMMAND...")
    area, heading, file, *command = arguments
    report = json.loads(read_text(file, "report"))
    write(area, keep(area, heading, report, shlex.join(command)))


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except InputError as error:
        raise SystemExit(f"results: {error}") from None

"""A folder of sessions at a glance: one index file beside them remembers what each held when it was last read."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil_gateway.process.errors import InputError
from hil_gateway.session.overview.summary import session_summary

INDEX = ".hil-sessions.json"
STORED_EVERY = 50
"""files read: who interrupts a long first call loses no more than these"""
VERSION = 1
"""of what an entry holds: an index of another version is made anew"""


@dataclass(frozen=True)
class Catalogue:
    """Entries by start, the newest last, and how many files had to be read for them."""

    entries: list[dict[str, Any]]
    read: int
    not_stored: str = ""
    """why the index could not be written; empty when it was"""


def catalogue(folder: Path, say: Callable[[str], None] = lambda text: None) -> Catalogue:
    """Every session in `folder` and below; a file is read again only when its size or time has changed.

    Raises:
        InputError: no such folder.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no folder")
    known, read = _load(folder), 0
    entries: dict[str, dict[str, Any]] = {}
    for name, stamp, path in _files(folder):
        entry = known.get(name)
        if entry is None or entry["stamp"] != stamp:
            read += 1
            say(f"reading {path}")
            entry = {"stamp": stamp, **_entry(path)}
            if read % STORED_EVERY == 0:
                _store(folder, {**known, **entries, name: entry})
        entries[name] = entry
    reason = _store(folder, entries) if entries != known else ""
    rows = [{"file": name, **{k: v for k, v in entry.items() if k != "stamp"}} for name, entry in entries.items()]
    return Catalogue(sorted(rows, key=lambda row: (row["started"], row["file"])), read, reason)


def _files(folder: Path) -> Iterator[tuple[str, list[int], Path]]:
    for path in sorted(folder.rglob("*.mcap")):
        if path.is_file():
            stat = path.stat()
            yield str(path.relative_to(folder)), [stat.st_size, stat.st_mtime_ns], path


def _entry(path: Path) -> dict[str, Any]:
    """What the list shows of one file; a file that cannot be read says why."""
    try:
        summary = session_summary(path)
    except InputError as error:
        return {"started": "", "bytes": path.stat().st_size, "unreadable": str(error)}
    return {
        "started": summary["started"],
        "bytes": path.stat().st_size,
        "track": summary["track"],
        "software": summary["software"],
        "laps": len(summary["laps"]),
        "best_lap_s": summary["best_lap_s"],
        "stops": [stop["cause"] for stop in summary["stops"]],
        "effects": summary["effects"],
        "suspected": [alert["suspect"] for alert in summary["alerts"] if alert["suspect"]],
    }


def _load(folder: Path) -> dict[str, dict[str, Any]]:
    try:
        tree = json.loads((folder / INDEX).read_text(encoding="utf-8"))
        entries: dict[str, dict[str, Any]] = tree["entries"] if tree["version"] == VERSION else {}
        return {name: entry for name, entry in entries.items() if isinstance(entry["stamp"], list)}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def _store(folder: Path, entries: dict[str, Any]) -> str:
    """Write the index whole or not at all; why not, where that fails: the list is right without it."""
    temporary = folder / f"{INDEX}.new"
    try:
        temporary.write_text(json.dumps({"version": VERSION, "entries": entries}), encoding="utf-8")
        temporary.replace(folder / INDEX)
    except OSError as error:
        return f"{folder / INDEX}: cannot write: {error.strerror}; every file is read again next time"
    return ""

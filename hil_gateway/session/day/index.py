"""What the recordings of a folder hold together: one index file beside them, which is made of them alone."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from hil_gateway.process.errors import InputError
from hil_gateway.session.overview.catalogue import STORED_EVERY
from hil_gateway.session.overview.info import recording_info
from hil_gateway.session.run import runs_below

INDEX = ".hil-day.json"
VERSION = 4
"""of what an entry holds: an index of another version is made anew"""
KEPT = (
    "start_unix_s", "duration_s", "bytes", "complete", "damage", "gaps", "laps", "best_lap_s", "runs", "remarks",
    "weather", "tyres", "km", "top_speed", "stops", "happened", "alerts", "revisions", "effects",
    "tyres_believed", "loop_ms", "lost",
)  # fmt: skip
"""of what is known of a session"""
Read = Callable[[Sequence[tuple[Path, ...]]], Iterable[dict[str, Any]]]
"""Entries of sessions, in their order."""


def read_session(files: tuple[Path, ...]) -> dict[str, Any]:
    """What the index keeps of the recordings of one session; why not, where they cannot be read."""
    try:
        info = recording_info(*files)
    except InputError as error:
        return {"unreadable": str(error)}
    if reason := info.get("story_unreadable"):
        return {"unreadable": reason}
    config, session = info["config"], info["session"]
    return {name: info[name] for name in KEPT} | {
        "track": Path(config.get("track") or "road_course").stem, "car": Path(config.get("platform") or "").name,
        "software": session.get("software", ""),
    }  # fmt: skip


def read_in_turn(sessions: Sequence[tuple[Path, ...]]) -> Iterator[dict[str, Any]]:
    """One after the other, in this process."""
    return map(read_session, sessions)


def read_day(folder: Path, read: Read = read_in_turn) -> dict[str, Any]:
    """Sessions of a folder and of those in it, in order of time; only what has changed is read again, by `read`.

    A session is one run of the gateway: files of a recorder that was restarted are one.

    Raises:
        InputError: no such folder, or no recording in it.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no folder")
    known = _load(folder / INDEX)
    files = {str(parts[0].relative_to(folder)): parts for parts in runs_below(folder)}
    if not files:
        raise InputError(f"{folder}: no recording in it or in its folders")
    stamps = {name: _stamp(folder, parts) for name, parts in files.items()}
    entries = {name: known[name] for name in files if name in known and known[name]["stamp"] == stamps[name]}
    new = [name for name in files if name not in entries]
    for count, (name, entry) in enumerate(zip(new, read([files[name] for name in new]), strict=True), start=1):
        entries[name] = {"stamp": stamps[name], **entry}
        if count % STORED_EVERY == 0:
            _store(folder / INDEX, {**known, **entries})
    entries = {name: entries[name] for name in files}
    if entries != known:
        _store(folder / INDEX, entries)
    rows = [{"file": name, "files": [row[0] for row in e["stamp"]], **e} for name, e in entries.items()]
    rows.sort(key=lambda row: (row.get("start_unix_s") or 0.0, row["file"]))
    sessions = [{"number": n, **{k: v for k, v in row.items() if k != "stamp"}} for n, row in enumerate(rows, start=1)]
    return {"sessions": sessions, "tyres": _tyres(sessions)}


def _stamp(folder: Path, files: Iterable[Path]) -> list[list[Any]]:
    return [[str(file.relative_to(folder)), file.stat().st_size, file.stat().st_mtime_ns] for file in files]


def lap_place(folder: Path, day: dict[str, Any], name: str) -> tuple[Path, int]:
    """First file of the session, and number in it, of a lap that the page calls `name`, as 2.5.

    Raises:
        InputError: no such lap.
    """
    if found := re.fullmatch(r"(\d+)\.(\d+)", name):
        number, lap = map(int, found.groups())
        for session in day["sessions"]:
            if session["number"] == number and 1 <= lap <= len(session.get("laps", ())):
                return folder / session["file"], lap
    raise InputError(f"lap {name}: not one of this day; laps are named session.lap, as 2.5: `hil day {folder}`")


def _tyres(sessions: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Laps and kilometres on each tyre set over the day."""
    found: dict[str, dict[str, float]] = {}
    for session in sessions:
        for name, used in session.get("tyres", {}).items():
            row = found.setdefault(name, {"laps": 0, "km": 0.0})
            row["laps"], row["km"] = row["laps"] + used["laps"], round(row["km"] + used["km"], 3)
    return found


def _load(path: Path) -> dict[str, dict[str, Any]]:
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
        return {n: e for n, e in tree["entries"].items() if tree["version"] == VERSION and isinstance(e["stamp"], list)}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def _store(path: Path, entries: dict[str, Any]) -> None:
    """Whole or not at all; the day is right without it, only slower."""
    temporary = path.with_name(f"{path.name}.new")
    try:
        temporary.write_text(json.dumps({"version": VERSION, "entries": entries}), encoding="utf-8")
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)

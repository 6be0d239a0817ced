"""Chosen sessions of a day as one file, without what names a person's folders; and back."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from pathlib import Path, PurePath
from typing import Any

from hil_gateway.process.errors import InputError
from hil_gateway.process.writable import check_file, check_folder
from hil_gateway.session.day.index import read_day
from hil_gateway.session.files.format import METADATA_SESSION
from hil_gateway.session.files.output import output_file
from hil_gateway.session.files.reader import Item
from hil_gateway.session.files.recover import recover

UNPACKED_MAX = 200_000_000_000
"""bytes that a shared day may claim: some hundred hours of driving; more is a mistake, or meant to fill the disk"""


def share_day(folder: Path, sessions: str, out: Path) -> str:
    """Write the chosen sessions ("1,3"; empty: all) to `out`; what was done, in words.

    Raises:
        InputError: no such session, or `out` cannot be written.
    """
    day = read_day(folder)
    chosen = _chosen(day, sessions)
    check_file(out, [folder / name for session in chosen for name in session["files"]])
    count = 0
    with output_file(out, folder) as target, zipfile.ZipFile(target, "w") as archive:
        for session in chosen:
            for name in session["files"]:
                part = target.with_name(f"{target.name}.part")
                try:
                    tracks = _copy_without_places(folder / name, part, folder)
                    archive.write(part, name)
                finally:
                    part.unlink(missing_ok=True)
                count += 1
                for track in tracks:
                    if (beside := str(PurePath(name).with_name(track.name))) not in archive.namelist():
                        archive.write(track, beside)
    return f"{len(chosen)} sessions in {count} recordings: {out}; `hil day open {out.name}` opens it"


def open_day(file: Path, folder: Path) -> Path:
    """Unpack a shared day into a new folder.

    Raises:
        InputError: no shared day, or the folder holds something already.
    """
    if folder.exists() and any(folder.iterdir()):
        raise InputError(f"{folder}: holds something already; name another with --out")
    try:
        with zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
            if not any(entry.filename.endswith(".mcap") for entry in entries):
                raise InputError(f"{file}: no recording in it: not a shared day")
            outside = [e.filename for e in entries if PurePath(e.filename).is_absolute() or ".." in e.filename]
            if outside or sum(entry.file_size for entry in entries) > UNPACKED_MAX:
                raise InputError(f"{file}: not a shared day: {outside[0] if outside else 'it claims to be too large'}")
            check_folder(folder)
            archive.extractall(folder)
    except (OSError, zipfile.BadZipFile) as error:
        raise InputError(f"{file}: cannot open it: {getattr(error, 'strerror', None) or error}") from None
    return folder


def _chosen(day: dict[str, Any], text: str) -> list[dict[str, Any]]:
    known = {str(session["number"]): session for session in day["sessions"]}
    names = [name.strip() for name in text.split(",")] if text else list(known)
    for name in names:
        if name not in known:
            raise InputError(f"--sessions {text}: no session {name}; the day has 1 to {len(known)}")
    return [known[name] for name in names]


def _copy_without_places(source: Path, target: Path, folder: Path) -> Sequence[Path]:
    """The recording with names of files in place of where they lie on this computer; track files it needs beside it."""
    personal = [f"{folder.resolve()}/", f"{source.resolve().parent}/", f"{Path.home()}/"]
    tracks: list[Path] = []

    def cleaned(text: str) -> str:
        for place in personal:
            text = text.replace(place, "")
        return text

    def metadata(name: str, values: dict[str, str]) -> dict[str, str]:
        if name == METADATA_SESSION and "config" in values:
            config = json.loads(values["config"])
            tracks.extend(_track_files(str(config.get("track") or "")))
            values = values | {"config": json.dumps(_names_only(config))}
        return {key: cleaned(value) for key, value in values.items()}

    def data(item: Item) -> bytes:
        return cleaned(item.data.decode()).encode() if item.stream.encoding == "json" else item.data

    recover(source, target, data=data, metadata=metadata)
    return tracks


def _track_files(track: str) -> list[Path]:
    path = Path(track)
    beside = (path, path.with_name(f"{path.stem}.pit.csv")) if path.is_absolute() else ()
    return [file for file in beside if file.is_file()]


def _names_only(tree: Any) -> Any:
    """A configuration with names in place of absolute paths."""
    if isinstance(tree, dict):
        return {key: _names_only(value) for key, value in tree.items()}
    if isinstance(tree, list):
        return [_names_only(value) for value in tree]
    return PurePath(tree).name if isinstance(tree, str) and tree.startswith("/") else tree

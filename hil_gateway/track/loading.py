"""Tracks by name or file: one reader a format, then the same smoothing."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

from hil_gateway.process.errors import InputError
from hil_gateway.process.shipped import did_you_mean, shipped
from hil_gateway.track.course import check_course
from hil_gateway.track.csv_file import lane_files, read_csv
from hil_gateway.track.layout import read_layout
from hil_gateway.track.smoothing import Survey, smooth
from hil_gateway.track.track import Track

DEFAULT_TRACK = "road_course"
READERS: dict[str, Callable[[Path], Survey]] = {".csv": read_csv, ".toml": read_layout}
"""file name ending -> reader: a further format is one module and one line here"""


def shipped_tracks() -> dict[str, Path]:
    """Name -> file of the tracks that come with the project."""
    return {path.stem: path for path in sorted(shipped("hil_gateway", "data/tracks").glob("*.toml"))}


def load_track(path: str | Path | None = None) -> Track:
    """Read a track: a CSV in the TUM convention, an own description (TOML), or the name of a shipped track.

    None or "" gives the shipped road course.

    Raises:
        InputError: no such file, or a file that does not describe a closed track that can be driven; names file,
            row and column.
    """
    file = _resolve(str(path or DEFAULT_TRACK))
    reader = READERS.get(file.suffix.lower())
    if reader is None:
        raise InputError(f"{file}: a track is a .csv (x_m,y_m,w_tr_right_m,w_tr_left_m) or a .toml description")
    try:
        changed = tuple((part.stat().st_mtime_ns, part.stat().st_size) for part in _parts(file))
    except OSError as error:
        raise InputError(f"{file}: cannot read: {error.strerror}") from None
    return _read(file, Path.cwd(), reader, changed)


def _parts(file: Path) -> tuple[Path, ...]:
    """The files a track is in."""
    return file, *lane_files(file)


@lru_cache
def _read(
    file: Path, _folder: Path, reader: Callable[[Path], Survey], _changed: tuple[tuple[int, int], ...]
) -> Track:  # fmt: skip
    """A quarter of a second of work, once for files that have not changed: a `Track` is never written to.

    A relative `file` is another one in another working folder.
    """
    return check_course(str(file), smooth(reader(file)))


def _resolve(name: str) -> Path:
    tracks = shipped_tracks()
    if name in tracks:
        return tracks[name]
    if not Path(name).is_file():
        hint = did_you_mean(name, list(tracks))
        raise InputError(f"{name}: no such track file; {hint}shipped tracks: {', '.join(tracks)}")
    return Path(name)

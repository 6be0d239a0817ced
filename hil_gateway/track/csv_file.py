"""Tracks from CSV files in the convention of the TUM race-track database.

Header `x_m,y_m,w_tr_right_m,w_tr_left_m` (a leading `#` is allowed), optionally `z_m` and `bank_rad`, in any
order, apart by commas, or by semicolons or tabs with either decimal mark; places on a UTM grid are moved, and that is
logged; `lat_deg,lon_deg` in place of x and y become metres from the first point of the track; one row a point, in
driving order, the last not repeating the first. A pit lane is the same, not closed, in `NAME.pit.csv` beside
`NAME.csv`, from where it leaves the road to where it is back, `speed_mps` (optional) where its limit holds, else 0; its
boxes are `NAME.boxes.csv`, `x_m,y_m,heading_rad` of the car's centre of gravity in each.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil_gateway.config import OriginConfig
from hil_gateway.process.arrays import Array
from hil_gateway.process.errors import InputError
from hil_gateway.text_file import read_text
from hil_gateway.track.geodesy import LocalMap
from hil_gateway.track.pit_lane import LaneSurvey, Place
from hil_gateway.track.smoothing import Survey

log = logging.getLogger(__name__)
REQUIRED = ("x_m", "y_m", "w_tr_right_m", "w_tr_left_m")
METRES, DEGREES = ("x_m", "y_m"), ("lat_deg", "lon_deg")
ALSO = {
    "lat": "lat_deg",
    "latitude": "lat_deg",
    "latitude_deg": "lat_deg",
    "longitude_deg": "lon_deg",
    "lon": "lon_deg",
    "lng": "lon_deg",
    "longitude": "lon_deg",
}
"""other name of a column, in small letters -> its name"""
OPTIONAL = ("z_m", "bank_rad", "speed_mps")
BOX = ("x_m", "y_m", "heading_rad")
LIMITS: dict[str, tuple[float, float]] = {
    "x_m": (-1e7, 1e7),
    "y_m": (-1e7, 1e7),
    "lat_deg": (-90.0, 90.0),
    "lon_deg": (-180.0, 180.0),
    "w_tr_right_m": (0.1, 100.0),
    "w_tr_left_m": (0.1, 100.0),
    "z_m": (-1e4, 1e4),
    "bank_rad": (-0.8, 0.8),
    "speed_mps": (0.0, 100.0),
    "heading_rad": (-7.0, 7.0),
}
"""column -> range of values that can be meant (a bank of 9 is in degrees, y of a UTM zone goes to 1e7 m)"""
SEPARATORS = ",;\t"
GRID_M = 1e5
"""Places further from the origin are on a national or UTM grid: no track is 100 km from its own origin."""
POINTS_MIN = 12
GAP_RATIO = 20.0
"""a step this many times the median one is a jump, not a track"""
GAP_MIN_M = 30.0
GRADE_MAX, HEIGHT_NOISE_M = 0.5, 2.0
"""steepest that can be meant, twice the steepest street; and what heights of a survey may scatter beside it"""


def read_csv(path: Path) -> Survey:
    """Read and check a track file.

    Raises:
        InputError: with file, row (line number), column, value and remedy.
    """
    columns, numbers = _columns(path)
    frame = _Frame.of(path, columns)
    columns |= frame.metres(path, columns)
    keep = _distinct(columns["x_m"], columns["y_m"])
    _check_line(path, numbers, columns["x_m"], columns["y_m"], keep)
    flat = np.zeros(len(numbers))
    _check_height(path, numbers, columns, columns.get("z_m", flat))
    return Survey(
        source=str(path),
        name=path.stem,
        x=columns["x_m"][keep],
        y=columns["y_m"][keep],
        width_left=columns["w_tr_left_m"][keep],
        width_right=columns["w_tr_right_m"][keep],
        z=columns.get("z_m", flat)[keep],
        bank=columns.get("bank_rad", flat)[keep],
        pit_lane=_read_lane(path, frame) if lane_files(path) else None,
    )


def lane_files(path: Path) -> tuple[Path, ...]:
    """Where the pit lane of a track file is, and its boxes, as far as it has them."""
    return tuple(part for kind in (".pit.csv", ".boxes.csv") if (part := path.with_suffix(kind)).is_file())


@dataclass(frozen=True)
class _Frame:
    """Where x and y of a track's files are counted from: a place in degrees, or metres that they are `moved` by."""

    origin: OriginConfig | None
    moved: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def of(cls, path: Path, columns: Mapping[str, Array]) -> _Frame:
        """The first point in degrees, or whole kilometres near it on a grid; either is said."""
        first = [float(columns[name][0]) for name in (*METRES, *DEGREES) if name in columns and len(columns[name])]
        if "lat_deg" in columns and first:
            log.warning("%s: m from %.7f, %.7f: the car's origin has to be there", path, *first)
            return cls(OriginConfig(latitude=first[0], longitude=first[1]))
        if not first or max(map(abs, first)) < GRID_M:
            return cls(None)
        moved = round(first[0], -3), round(first[1], -3)
        log.warning("%s: x, y are on a grid: moved by %.0f, %.0f m", path, -moved[0], -moved[1])
        return cls(None, moved)

    def metres(self, path: Path, columns: Mapping[str, Array]) -> dict[str, Array]:
        """`x_m`, `y_m` (n,) of a file with them, or with degrees as the track's own.

        Raises:
            InputError: one is in degrees, the other in metres.
        """
        if (self.origin is None) != ("x_m" in columns):
            raise InputError(f"{path}:1: its places are in another form than the track's: give both in m or in degrees")
        if self.origin is None:
            return {name: columns[name] - by for name, by in zip(METRES, self.moved, strict=True)}
        to_map = LocalMap(self.origin).to_map
        places = [to_map(*place) for place in zip(*(columns[name].tolist() for name in DEGREES), strict=True)]
        return dict(zip(METRES, np.array(places).reshape(-1, 2).T, strict=True))


def _read_lane(path: Path, frame: _Frame) -> LaneSurvey:
    lane, boxes = path.with_suffix(".pit.csv"), path.with_suffix(".boxes.csv")
    columns, numbers = _columns(lane)
    x, y = frame.metres(lane, columns).values()
    speed, ends = _limit(lane, columns.get("speed_mps", np.zeros(len(x))), numbers)
    limit = None if speed is None else ((x[ends[0]], y[ends[0]], 0.0), (x[ends[1]], y[ends[1]], 0.0))
    places = _read_boxes(boxes, frame) if boxes.is_file() else ()
    return LaneSurvey(str(lane), x, y, columns["w_tr_left_m"], columns["w_tr_right_m"], speed, limit, places)


def _limit(path: Path, speeds: Array, numbers: list[int]) -> tuple[float | None, tuple[int, int]]:
    """The speed limit of a lane, m/s, and its first and last row; None where there is none."""
    rows = np.flatnonzero(speeds)
    if not len(rows):
        return None, (0, 0)
    speed = float(speeds[rows[0]])
    if (other := rows[speeds[rows] != speed]).size:
        raise InputError(
            f"{path}:{numbers[other[0]]}: speed_mps = {speeds[other[0]]:g} where it was {speed:g} before;"
            " a pit lane has one limit, and 0 where that does not hold"
        )
    return speed, (int(rows[0]), int(rows[-1]))


def _read_boxes(path: Path, frame: _Frame) -> tuple[Place, ...]:
    columns, _ = _columns(path, BOX)
    x, y = frame.metres(path, columns).values()
    return tuple(zip(x.tolist(), y.tolist(), columns["heading_rad"].tolist(), strict=True))


def _columns(path: Path, required: tuple[str, ...] = REQUIRED) -> tuple[dict[str, Array], list[int]]:
    """Columns by name, those `required` or with degrees for metres, and the line number of every row."""
    lines = read_text(path, "track").splitlines()
    separator = max(SEPARATORS, key=lines[0].count) if lines else ","
    if separator != ",":
        lines = [lines[0].replace(separator, ","), *(_with_commas(line, separator) for line in lines[1:])]
    found = [name.strip().strip('"').lower() for name in lines[0].lstrip("# ").split(",")] if lines else []
    names = [ALSO.get(name.removesuffix("_deg"), name) for name in found]
    if not {*METRES} <= {*names} and {*DEGREES} & {*names}:
        required = *DEGREES, *required[2:]
    if twice := next((name for name in LIMITS if names.count(name) > 1), ""):
        raise InputError(f"{path}:1: column {twice} is there twice; leave one")
    missing = [name for name in required if name not in names]
    if missing:
        raise InputError(f"{path}:1: column {missing[0]} is missing; the header must name {','.join(required)}")
    rows = [(i, line) for i, line in enumerate(lines[1:], start=2) if line.strip() and not line.startswith("#")]
    table = np.array([_row(path, number, line, names) for number, line in rows]).reshape(len(rows), len(names))
    columns = {name: table[:, names.index(name)] for name in (*required, *OPTIONAL) if name in names}
    return columns, [number for number, _ in rows]


def _with_commas(line: str, separator: str) -> str:
    """A row with decimal points, apart by commas."""
    return line.replace(",", ".").replace(separator, ",")


def _row(path: Path, number: int, line: str, names: list[str]) -> list[float]:
    cells = line.split(",")
    if len(cells) != len(names):
        raise InputError(f"{path}:{number}: {len(cells)} values, the header names {len(names)} columns")
    return [_value(path, number, name, cell.strip()) for name, cell in zip(names, cells, strict=True)]


def _value(path: Path, number: int, name: str, text: str) -> float:
    if name not in LIMITS:
        return 0.0  # further columns are carried by some files and mean nothing here
    low, high = LIMITS[name]
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"{path}:{number}: {name} = {text!r} is not a number") from None
    if not low <= value <= high:
        raise InputError(f"{path}:{number}: {name} = {text} is outside {low:g} to {high:g}; units are m and rad")
    return value


def _distinct(x: Array, y: Array) -> Array:
    """Mask of points that differ from their predecessor (files often repeat the first point at the end)."""
    return np.asarray(np.hypot(x - np.roll(x, 1), y - np.roll(y, 1)) > 1e-6)


def _check_line(path: Path, numbers: list[int], x: Array, y: Array, keep: Array) -> None:
    index = np.flatnonzero(keep)
    if len(index) < POINTS_MIN:
        raise InputError(f"{path}: {len(index)} different points; a track needs at least {POINTS_MIN}")
    steps = np.hypot(np.diff(x[index], append=x[index[0]]), np.diff(y[index], append=y[index[0]]))
    limit = max(GAP_MIN_M, GAP_RATIO * float(np.median(steps)))
    worst = int(np.argmax(steps))
    if steps[worst] <= limit:
        return
    where = f"{path}:{numbers[index[worst]]}"
    if worst == len(index) - 1:
        raise InputError(f"{where}: the track is not closed: {steps[worst]:.1f} m from the last point to the first")
    raise InputError(f"{where}: {steps[worst]:.1f} m to the next point (limit {limit:.1f} m); points must be in order")


def _check_height(path: Path, numbers: list[int], columns: dict[str, Array], z: Array) -> None:
    along = np.hypot(np.diff(columns["x_m"]), np.diff(columns["y_m"]))
    beyond = np.abs(np.diff(z)) - HEIGHT_NOISE_M > GRADE_MAX * along
    if beyond.any():
        at = int(np.argmax(beyond))
        rise = f"z_m changes by {z[at + 1] - z[at]:.1f} m over {along[at]:.1f} m"
        raise InputError(
            f"{path}:{numbers[at]}: {rise}, a grade of at most {GRADE_MAX:g} can be driven; is it in metres?"
        )

"""How far a car and a model may go: caps that begin low and rise run by run.

Nothing but clean runs raises them, and each by one step: what has not been driven is not known.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from hil_gateway.bus.track_day.race_control import MOST_SPEED
from hil_gateway.process.errors import InputError
from hil_gateway.process.figures import figure
from hil_gateway.text_file import read_json

SPEED_STEP = 10.0
"""m/s a clean run"""
LOAD_STEP = 0.15
"""share of the grip a clean run"""


@dataclass(frozen=True)
class Caps:
    """Most speed (m/s) and most share of the grip."""

    speed: float
    load_use: float

    def raised(self) -> Caps:
        """After a clean run."""
        return Caps(min(self.speed + SPEED_STEP, MOST_SPEED), min(self.load_use + LOAD_STEP, 1.0))

    def __str__(self) -> str:
        return f"{figure(self.speed, 'm/s', 3)}, {100 * self.load_use:.0f} % of the grip"


FIRST = Caps(30.0, 0.5)
"""of what has never driven: with half of its grip a car whose tyres give half of what is believed keeps to the road; a
controlled stop of 6 m/s2 takes 75 m from 30 m/s"""
FREE = Caps(MOST_SPEED, 1.0)


class Expansion:
    """Caps reached by car and model, kept in a file where one is named.

    Raises:
        InputError: the file is there and cannot be read.
    """

    def __init__(self, file: str = "") -> None:
        self._file = Path(file) if file else None
        self._reached = _read(self._file) if self._file and self._file.exists() else {}

    def caps(self, key: str) -> tuple[Caps, str]:
        """What `key` may do in its next run, and why."""
        if key not in self._reached:
            return FIRST, f"default of a car and a model that have not driven: {FIRST}"
        caps = self._reached[key]
        return caps, f"reached in clean runs: {caps}"

    def clean_run(self, key: str, driven: Caps) -> str:
        """A run of `key` was clean with the caps `driven`; what follows from it, in words."""
        before = self._reached.get(key, FIRST)
        reached = driven.raised()
        risen = Caps(max(before.speed, reached.speed), max(before.load_use, reached.load_use))
        self._reached[key] = risen
        return f"clean: the next run may do {risen}{self._store()}"

    def _store(self) -> str:
        """Keep the caps; why not, in words: a full disk must not end the planner."""
        if self._file is None:
            return ""
        text = json.dumps({key: asdict(caps) for key, caps in self._reached.items()})
        temporary = self._file.with_name(f"{self._file.name}.new")
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            temporary.write_text(text, encoding="utf-8")
            temporary.replace(self._file)
        except OSError as error:
            return f"; not kept for the next start: {self._file}: {error.strerror}"
        return ""


def _read(path: Path) -> dict[str, Caps]:
    try:
        tree = read_json(path, "caps")
        return {key: Caps(float(row["speed"]), float(row["load_use"])) for key, row in tree.items()}
    except (KeyError, TypeError, ValueError, AttributeError):
        raise InputError(f"{path}: not a file of caps; delete it, and they begin anew") from None

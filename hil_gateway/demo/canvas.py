"""Line drawing in Braille characters: 2 x 4 dots in a terminal cell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

_BASE = 0x2800
_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""bit of the dot in (row, column) of a cell"""


@dataclass(frozen=True)
class Cell:
    """Place of a character."""

    row: int
    column: int


class Canvas:
    """A map of `width` x `height` characters showing the points (x, y), equally scaled, y up."""

    def __init__(self, x: Sequence[float], y: Sequence[float], width: int, height: int) -> None:
        self.width, self.height = width, height
        self._left, self._top = min(x), max(y)
        span_x, span_y = max(x) - self._left, self._top - min(y)
        self._scale = min((2 * width - 1) / max(span_x, 1e-9), (4 * height - 1) / max(span_y, 1e-9))
        self._margin_x = (2 * width - 1 - span_x * self._scale) / 2
        self._margin_y = (4 * height - 1 - span_y * self._scale) / 2
        self._bits = [[0] * width for _ in range(height)]
        for px, py in zip(x, y, strict=True):
            self._set(px, py)

    def _dot(self, x: float, y: float) -> tuple[int, int]:
        column = round((x - self._left) * self._scale + self._margin_x)
        row = round((self._top - y) * self._scale + self._margin_y)
        return row, column

    def _set(self, x: float, y: float) -> None:
        row, column = self._dot(x, y)
        self._bits[row // 4][column // 2] |= _DOTS[row % 4][column % 2]

    def cell(self, x: float, y: float) -> Cell:
        """Character cell of a point, held inside the map."""
        row, column = self._dot(x, y)
        return Cell(min(max(row // 4, 0), self.height - 1), min(max(column // 2, 0), self.width - 1))

    def lines(self) -> list[str]:
        """The map, one string a line."""
        return ["".join(chr(_BASE + bits) for bits in row) for row in self._bits]

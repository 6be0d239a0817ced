"""Which elements of a QP's blocks can be other than zero, and the order in which generated code keeps them.

The generated solver keeps the elements of W stages side by side, element after element: `data[group][element][lane]`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
import numpy.typing as npt

from planner.solver.qp import QpSize

Mask = npt.NDArray[np.bool_]
Place = tuple[int, int]

ARRAYS = (
    "A", "B", "b", "Q", "q", "R", "r", "C", "lower_row", "upper_row", "lower_z", "upper_z", "lower_u", "upper_u",
    "slack_l1", "slack_l2",
)  # fmt: skip
"""arrays of `qp.StageQp` that a solver reads, in the order of the packed elements"""


@dataclass(frozen=True)
class Element:
    """One packed element: block `array`, position in a stage's block; `mirror` is its twin in a symmetric block."""

    array: str
    row: int
    column: int
    mirror: bool = False


@dataclass(frozen=True)
class Pattern:
    """Sizes, structural non-zeros of the blocks (boolean, shapes of the blocks), and which sides soft rows have."""

    size: QpSize
    A: Mask
    B: Mask
    Q: Mask
    R: Mask
    C: Mask
    lower_sides: tuple[int, ...]
    """soft rows with a lower side"""
    upper_sides: tuple[int, ...]

    @classmethod
    def dense(cls, size: QpSize, mask_lower: npt.ArrayLike, mask_upper: npt.ArrayLike) -> Pattern:
        """Every element of every block."""
        shapes = {"A": (size.nx, size.nx), "B": (size.nx, size.nu), "Q": (size.nx, size.nx), "R": (size.nu, size.nu)}
        blocks = {name: np.ones(shape, dtype=bool) for name, shape in shapes.items()}
        sides = [tuple(np.flatnonzero(np.asarray(m) > 0).tolist()) for m in (mask_lower, mask_upper)]
        blocks["C"] = np.ones((size.rows, size.nx), dtype=bool)
        return cls(size, **blocks, lower_sides=sides[0], upper_sides=sides[1])

    @cached_property
    def elements(self) -> tuple[Element, ...]:
        """All packed elements; of the symmetric blocks Q and R the lower triangle."""
        size = self.size
        columns = {
            "b": size.nx, "q": size.nx, "r": size.nu, "lower_z": len(size.bounded), "upper_z": len(size.bounded),
            "lower_u": size.nu, "upper_u": size.nu,
        }  # fmt: skip
        blocks = {f.name: getattr(self, f.name) for f in fields(self) if f.name in "ABQRC"}
        found: list[Element] = []
        for name in ARRAYS:
            mask = blocks.get(name)
            if mask is None:
                found += [Element(name, i, 0) for i in range(columns.get(name, size.rows))]
                continue
            symmetric = name in "QR"
            mask = np.tril(mask | mask.T) if symmetric else mask
            places = ((i, j) for j in range(mask.shape[1]) for i in range(mask.shape[0]) if mask[i, j])
            found += [Element(name, i, j, symmetric and i != j) for i, j in places]
        return tuple(found)

    @cached_property
    def index(self) -> dict[tuple[str, int, int], int]:
        """Number of the packed element of a block at (row, column)."""
        return {(e.array, e.row, e.column): n for n, e in enumerate(self.elements)}

    def places(self, array: str) -> list[Place]:
        """(row, column) of the packed elements of a block."""
        return [(e.row, e.column) for e in self.elements if e.array == array]

    @cached_property
    def hessian(self) -> list[Place]:
        """Lower triangle of Q + C' W C + bounds: what the condensed Hessian of a stage can have."""
        size = self.size
        filled = self.Q | (self.C.T.astype(int) @ self.C.astype(int) > 0)
        filled[list(size.bounded), list(size.bounded)] = True
        return [(i, j) for j in range(size.nx) for i in range(j, size.nx) if filled[i, j] or filled[j, i]]

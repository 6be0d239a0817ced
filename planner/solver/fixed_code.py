"""C source of the solver of one problem: sizes, stage functions, linear algebra and the iterations around them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from planner.problem import infomax
from planner.problem.motion import BOUNDED, NU, NZ
from planner.problem.mpcc import OUTPUTS, Problem
from planner.solver.expressions import SCALAR, VECTOR, Translation, nonzero_elements, translate
from planner.solver.kkt_code import generate
from planner.solver.pattern import ARRAYS, Pattern
from planner.solver.qp import QpSize

FOLDER = Path(__file__).parent
COUPLED_ROWS = ("load_front", "load_rear")
"""soft rows whose multipliers the stage functions are given, in the order of the stage parameter `multiplier`"""


@dataclass(frozen=True)
class StageCode:
    """What the generated code needs of a problem beyond its QP's pattern."""

    translation: Translation
    stage_size: int
    coupled: tuple[tuple[int, int], ...] = ()
    """(stage parameter, soft row) of each multiplier the stage functions use"""
    change_bounds: tuple[float, ...] = ()
    curved: tuple[int, ...] = ()
    """states of the exact Hessian of the information"""
    projected: bool = False


def source_of(pattern: Pattern, stage: StageCode, width: int) -> str:
    """The whole C source, W = `width` stages side by side."""
    step = _template("stage_step.h")
    step = step.replace("EACH_GROUP", "\n".join(stage.translation.each))
    step = step.replace("SHARED", "\n".join(stage.translation.shared))
    sizes, functions = generate(pattern, width)
    parts = (
        f"#define _POSIX_C_SOURCE 199309L\n#define W {width}\n#define N {pattern.size.N}", _template("lanes.h"), sizes,
        _tables(pattern, stage), _template("qp_layout.h"), functions, _template("interior_point.h"), step,
    )  # fmt: skip
    return "\n".join(parts) + "\n"


def _template(name: str) -> str:
    return (FOLDER / name).read_text()


def _table(kind: str, name: str, values: Sequence[str]) -> str:
    return f"static const {kind} {name} = {{{', '.join(values)}}};"


def _tables(pattern: Pattern, stage: StageCode) -> str:
    """Constants of `stage_step.h`; where a table would be empty it has one unused entry."""
    curved, hard = stage.curved, 2 * (pattern.size.nu + len(pattern.size.bounded))
    numbers = {
        "STAGE": max(1, stage.stage_size), "COUPLED": len(stage.coupled), "CURVED": len(curved), "BLOCKS": len(ARRAYS),
    }  # fmt: skip
    sides = [hard + pattern.upper_sides.index(r) if r in pattern.upper_sides else -1 for r in range(pattern.size.rows)]
    bounds = stage.change_bounds or (1.0,) * pattern.size.nu
    coupled = stage.coupled or ((0, 0),)
    lines = [
        f"enum {{ {', '.join(f'{name} = {value}' for name, value in numbers.items())} }};",
        f"#define PROJECTED {int(stage.projected)}",
        _table("int", "coupled_at[]", [str(at) for at, _ in coupled]),
        _table("int", "coupled_row[]", [str(row) for _, row in coupled]),
        _table("int", "upper_side[]", [*map(str, sides), "-1"]),
        _table("double", "change_bound[NU]", [repr(b) for b in bounds]),
        _table("struct { int array, stride, at, twin; }", "place[ELEMENTS]", _places(pattern)),
        _table("double", "neutral[ELEMENTS]", [_neutral(e.array) for e in pattern.elements]),
    ]
    if stage.projected:
        rows = [[str(pattern.index["Q", max(i, j), min(i, j)]) for j in curved] for i in curved]
        lines.append(_table("int", "curved_at[CURVED][CURVED]", [f"{{{', '.join(row)}}}" for row in rows]))
    return "\n".join(lines)


def _places(pattern: Pattern) -> list[str]:
    """Where in the blocks of a `StageQp` each packed element is: array, size of a stage's block, position, twin."""
    size = pattern.size
    shapes = {"A": (size.nx, size.nx), "B": (size.nx, size.nu), "Q": (size.nx, size.nx), "R": (size.nu, size.nu)}
    shapes |= {"C": (size.rows, size.nx), "b": (size.nx, 1), "q": (size.nx, 1), "r": (size.nu, 1)}
    for side in ("lower", "upper"):
        shapes |= {f"{side}_u": (size.nu, 1), f"{side}_z": (len(size.bounded), 1)}
    lines = []
    for e in pattern.elements:
        rows, columns = shapes.get(e.array, (size.rows, 1))
        at = e.column * rows + e.row
        twin = e.row * rows + e.column if e.mirror else at
        lines.append(f"{{{ARRAYS.index(e.array)}, {rows * columns}, {at}, {twin}}}")
    return lines


def _neutral(array: str) -> str:
    """Value in stages beyond the horizon: inequalities that are slack, nothing else."""
    return "-1" if array.startswith("lower") else "1" if array.startswith(("upper", "slack")) else "0"


def problem_source(problem: Problem, f: ca.Function, width: int) -> str:
    """C source of the solver of a problem with the stage function `f`."""
    symbols: list[Any] = [ca.SX.sym(name, *f.size_in(i)) for i, name in enumerate(f.name_in())]
    results = dict(zip(f.name_out(), f.call(symbols), strict=True))
    pattern = pattern_of(problem, results)
    packed = [results[e.array][e.row, e.column] for e in pattern.elements if not e.array.startswith("slack")]
    packed += [value for penalties in zip(*problem.slack(), strict=True) for value in penalties]
    outputs: list[Any] = [ca.densify(ca.vertcat(*packed)), results["info"], ca.vec(results["info_hessian"])]
    stage4 = ca.Function("stage", symbols, ca.cse(outputs))
    inputs = [(VECTOR, text) for text in ("before[{0}]", "change[{0}]", "after[{0}]", "stage[{0}]")]
    translation = translate(stage4, [*inputs, (SCALAR, "common[{0}]")], ["d[{0}]", "info[{0}]", "curved[{0}]"])
    first = problem.stage["multiplier"].start
    coupled = tuple((first + n, problem.rows.index(row)) for n, row in enumerate(COUPLED_ROWS))
    code = StageCode(
        translation, problem.stage.size, coupled, problem.change_bounds(), infomax.FORCE_STATES, projected(problem)
    )
    return source_of(pattern, code, width)


def blocks_source(pattern: Pattern, width: int) -> str:
    """C source of a QP solver alone, without stage functions."""
    return source_of(pattern, StageCode(Translation([], []), 0), width)


def projected(problem: Problem) -> bool:
    """Whether the exact Hessian of the information is added to Q, its negative eigenvalues cut off."""
    return problem.informative and problem.settings.information.convexification == "projection"


def pattern_of(problem: Problem, results: dict[str, Any]) -> Pattern:
    """Non-zeros of the blocks as the stage functions have them."""
    size = QpSize(problem.settings.horizon, NZ, NU, BOUNDED, len(problem.rows))
    found = nonzero_elements({name: results[name] for name in OUTPUTS})
    blocks = {}
    for name in "ABQRC":
        mask = np.zeros(results[name].shape, dtype=bool)
        for place in found[name]:
            mask[place] = True
        blocks[name] = mask
    if projected(problem):
        blocks["Q"][np.ix_(infomax.FORCE_STATES, infomax.FORCE_STATES)] = True
    lower = tuple(r for r, m in enumerate(problem.mask_lower) if m > 0)
    return Pattern(size, **blocks, lower_sides=lower, upper_sides=tuple(range(size.rows)))

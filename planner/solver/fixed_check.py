"""The check of a plan generated for one model: road beside the plan, and every limit on stages side by side, in C.

Its equations share nothing with the solver's, the way to C does: a self-test compares with CasADi's virtual machine.
Without a compiler, or where its self-test fails, the same equations run in CasADi's virtual machine and the road is
looked up by numpy (`plan.checks`).
"""

from __future__ import annotations

import ctypes
import warnings
from pathlib import Path
from typing import Any, Protocol

import casadi as ca
import numpy as np

from hil_gateway.process.arrays import Array
from hil_gateway.process.compiled import compile_source, find_compiler
from planner.problem.checked_motion import BOUNDS, COLUMNS, FOUND, CheckedMotion
from planner.problem.motion import MOST_LIFT, NZ
from planner.solver.expressions import SCALAR, VECTOR, TranslationError, translate
from planner.solver.fixed import WIDTH
from planner.solver.qp import QpWarning

WINDOW = 6
"""points of the race line either side of the predicted progress among which the nearest is sought"""
FOLDER = Path(__file__).parent


class RoadsidePoints(Protocol):
    """What is beside the plan: rows of points (13, n) of a closed line at equal steps, see `plan.checks.Roadside`."""

    points: Array
    spacing: float


class FixedCheck:
    """One generated library in the form of a `CompiledFunction` of `CheckedMotion`, with the road looked up as well."""

    backend = "compiled, four stages at a time"

    def __init__(self, path: Path, motion: CheckedMotion, stages: int) -> None:
        lib = ctypes.CDLL(str(path))
        self._check, self._lay_out = lib.check, lib.lay_out
        # one array: the stage before each is the column before it
        self._columns = np.zeros((len(COLUMNS), stages + 1), order="F")
        sizes = (len(motion.model.tyre_table), len(motion.model.effect_table), 1, len(BOUNDS))
        parameters = tuple(np.zeros((size, 1)) for size in sizes)
        self.inputs: tuple[Array, ...] = (self._columns[:, :-1], self._columns[:, 1:], *parameters)
        self.outputs: tuple[Array, ...] = (np.zeros((len(FOUND), stages), order="F"),)
        self._z, self._information = np.zeros((NZ, stages), order="F"), np.zeros(stages - 1)
        self._beside: RoadsidePoints | None = None
        self.finite = False
        """whether every number of the plan checked last is one"""
        self._arguments = tuple(map(_pointer, (self._columns, *parameters, self.outputs[0])))
        self._plan = tuple(map(_pointer, (self._z, self._information)))

    def __call__(self) -> None:
        """Evaluate from `inputs` into `outputs`."""
        self.finite = bool(self._check(*self._arguments))

    def lay_out(self, z: Array, information: Array, beside: RoadsidePoints) -> Array:
        """`COLUMNS` of states z (NZ, N+1) with the information (N,), beside a line; they are the input `after`."""
        self._z[:], self._information[:] = z, information
        if beside is not self._beside:
            self._beside = beside
            points, size = _pointer(beside.points), ctypes.c_int32(beside.points.shape[1])
            self._road = points, size, ctypes.c_double(1.0 / beside.spacing), _pointer(self._columns)
        self._lay_out(*self._plan, *self._road)
        return self.inputs[1]


def _pointer(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def build_check(motion: CheckedMotion, stages: int) -> Path | None:
    """Library of a model, from the cache or freshly built; None where there is no compiler.

    None with a warning where code cannot be generated, or does not answer as it must.
    """
    if find_compiler() is None:
        return None
    stage = motion.stage_function()
    try:
        path = compile_source(_source(stage, stages))
        if path is not None:
            _compare(FixedCheck(path, motion, stages), stage)
        return path
    except (TranslationError, OSError, RuntimeError) as error:
        warnings.warn(f"generated check is not usable ({error}); a plan takes 0.1 ms longer", QpWarning, stacklevel=2)
        return None


def _source(stage: ca.Function, stages: int) -> str:
    inputs = [(VECTOR, "before[{0}]"), (VECTOR, "after[{0}]")]
    inputs += [(SCALAR, f"{name}[{{0}}]") for name in ("theta", "phi", "ratio", "bounds")]
    code = translate(stage, inputs, ["d[{0}]"])
    numbers = {"W": WIDTH, "STAGES": stages, "AROUND": WINDOW, "MOST_LIFT": MOST_LIFT, "NX": NZ}
    numbers |= {"COLUMNS": len(COLUMNS), "FOUND": len(FOUND)}
    text = (FOLDER / "check.h").read_text()
    text = text.replace("EACH_GROUP", "\n".join(code.each)).replace("SHARED", "\n".join(code.shared))
    defined = "\n".join(f"#define {name} {value}" for name, value in numbers.items())
    return "\n".join((defined, (FOLDER / "lanes.h").read_text(), text)) + "\n"


def _compare(check: FixedCheck, stage: ca.Function) -> None:
    """Against CasADi's virtual machine, at arbitrary arguments.

    Raises:
        RuntimeError: they differ.
    """
    rng, stages = np.random.default_rng(0), check.inputs[1].shape[1]
    for array in check.inputs[1:]:
        array[:] = rng.uniform(0.5, 1.5, array.shape)
    check.inputs[0][:, 0] = check.inputs[1][:, 0]
    check()
    expected: Any = stage.map("expected", "serial", stages, [2, 3, 4, 5], [])(*check.inputs)
    if not np.allclose(check.outputs[0], np.array(expected), rtol=1e-8, atol=1e-8):
        raise RuntimeError("self-test failed: what is found differs from CasADi's")

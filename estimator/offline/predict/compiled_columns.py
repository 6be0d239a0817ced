"""`Columns` whose instruction list is run by a C program, in half the time of numpy; without a compiler by numpy.

The program is the same for all functions and compiled once: a search tries hundreds of models.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np

from estimator.model.columns import Columns
from estimator.model.library import Library, load_library
from hil_gateway.process.arrays import Array

OPERATIONS = (
    "INPUT", "OUTPUT", "CONST", "ASSIGN", "ADD", "SUB", "MUL", "DIV", "NEG", "SQ", "TWICE", "INV", "SQRT", "FABS",
    "SIGN", "FMIN", "FMAX", "FMOD", "FLOOR", "CEIL", "COPYSIGN", "IF_ELSE_ZERO", "LT", "LE", "EQ", "NE", "AND", "OR",
    "NOT", "POW", "CONSTPOW", "HYPOT", "EXP", "EXPM1", "LOG", "LOG1P", "SIN", "COS", "TAN", "ASIN", "ACOS", "ATAN",
    "ATAN2", "SINH", "COSH", "TANH",
)  # fmt: skip
"""CasADi's operations that the program knows: all that `Columns` does."""


@cache
def columns_library() -> Library | None:
    """The program; None without a compiler."""
    numbers = [f"#define OP_{name} {getattr(ca, f'OP_{name}')}\n" for name in OPERATIONS]
    return load_library(Path(__file__).with_name("columns.c"), "".join(numbers))


class CompiledColumns(Columns):
    """`f(x (k,), p (m,)) -> y (q,)` evaluated for many x at one p."""

    def __init__(self, f: ca.Function) -> None:
        """Read the instruction list of an SX function with dense inputs and output."""
        super().__init__(f)
        first = np.cumsum([0, *self._sizes])
        self._steps = np.array([_step(f, k, first) for k in range(f.n_instructions())], np.int64)
        constants = np.flatnonzero(self._steps[:, 0] == ca.OP_CONST).tolist()
        self._constants = np.zeros(len(self._steps))
        self._constants[constants] = [f.instruction_constant(k) for k in constants]

    def __call__(self, *arguments: Array) -> Array:
        """(q, n) outputs of all samples."""
        library = columns_library()
        if library is None:
            return super().__call__(*arguments)
        given = [np.ascontiguousarray(a) for a in arguments]
        n = max(a.shape[1] for a in given if a.ndim == 2)
        rows = np.concatenate([a.ctypes.data + a.strides[0] * np.arange(len(a), dtype=np.int64) for a in given])
        per_sample = np.concatenate([np.full(len(a), a.ndim - 1, np.int64) for a in given])
        result = np.empty((self.outputs, n))
        program = (self._steps, self._constants)
        library.call("evaluate", n, len(self._steps), self._work, *program, rows, per_sample, result)
        return result


def _step(f: ca.Function, k: int, first: Array) -> tuple[int, int, int, int]:
    """Operation, what it reads, what it writes; the elements of all arguments are counted through."""
    operation, reads, writes = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
    if operation == ca.OP_INPUT:
        return operation, int(first[reads[0]]) + reads[1], 0, writes[0]
    if operation == ca.OP_OUTPUT:
        return operation, reads[0], 0, writes[1]
    return operation, *([*reads, 0, 0][:2] if operation != ca.OP_CONST else (0, 0)), writes[0]

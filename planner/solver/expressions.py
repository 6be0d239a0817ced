"""CasADi expressions as straight C on vectors of stages (`lanes.h`): one statement an instruction.

What depends on parameters shared by all stages only is scalar and computed once before the loop over the stages.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

SCALAR, VECTOR, MASK = "double", "vec", "mask"

_INFIX = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}
_COMPARED = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}
_FORMULA = {
    ca.OP_NEG: "-{0}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "2.0 * {0}", ca.OP_INV: "1.0 / {0}", ca.OP_ASSIGN: "{0}",
}  # fmt: skip
_CALLED = {
    ca.OP_SIN: "sin", ca.OP_COS: "cos", ca.OP_TAN: "tan", ca.OP_ATAN: "atan", ca.OP_TANH: "tanh", ca.OP_EXP: "exp",
    ca.OP_LOG: "log", ca.OP_SQRT: "sqrt", ca.OP_FABS: "fabs", ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil",
    ca.OP_ASIN: "asin", ca.OP_ACOS: "acos", ca.OP_SINH: "sinh", ca.OP_COSH: "cosh", ca.OP_ATAN2: "atan2",
    ca.OP_POW: "pow", ca.OP_CONSTPOW: "pow", ca.OP_FMOD: "fmod", ca.OP_FMIN: "fmin", ca.OP_FMAX: "fmax",
    ca.OP_SIGN: "sign",
}  # fmt: skip
_VECTOR_NAME = {"fabs": "v_abs", "fmin": "v_min", "fmax": "v_max"}


class TranslationError(RuntimeError):
    """An operation that the translation to C does not know."""


@dataclass(frozen=True)
class _Value:
    kind: str
    name: str

    @property
    def number(self) -> str:
        """As a number: a mask is 1 where it is set."""
        return f"keep({self.name}, all(1.0))" if self.kind is MASK else self.name

    @property
    def vector(self) -> str:
        return f"all({self.name})" if self.kind is SCALAR else self.number

    @property
    def condition(self) -> str:
        return self.name if self.kind is MASK else f"yes({self.vector})"


@dataclass
class Translation:
    """C statements: `shared` before the loop over groups of stages, `each` inside it."""

    shared: list[str]
    each: list[str]


def translate(function: ca.Function, inputs: Sequence[tuple[str, str]], targets: Sequence[str]) -> Translation:
    """Statements of an SX function.

    `inputs` are (kind, C expression with `{0}` for the element), `targets` the C expressions assigned to, with `{0}`
    for the element of that output.

    Raises:
        TranslationError: an operation outside the tables of this module.
    """
    return _Translator(function, inputs, targets).run()


class _Translator:
    def __init__(self, function: ca.Function, inputs: Sequence[tuple[str, str]], targets: Sequence[str]) -> None:
        self._function, self._inputs, self._targets = function, inputs, targets
        self._slots: dict[int, _Value] = {}
        self._result = Translation([], [])

    def run(self) -> Translation:
        for k in range(self._function.n_instructions()):
            self._instruction(k)
        return self._result

    def _instruction(self, k: int) -> None:
        f = self._function
        operation, sources, targets = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            value = self._slots[sources[0]].vector
            self._result.each.append(f"{self._targets[targets[0]].format(targets[1])} = {value};")
        elif operation == ca.OP_CONST:
            self._slots[targets[0]] = _Value(SCALAR, _literal(float(f.instruction_constant(k))))
        elif operation == ca.OP_INPUT:
            kind, expression = self._inputs[sources[0]]
            self._define(k, targets[0], kind, expression.format(sources[1]))
        else:
            kind, text = _operation(operation, [self._slots[s] for s in sources])
            self._define(k, targets[0], kind, text)

    def _define(self, k: int, slot: int, kind: str, text: str) -> None:
        lines = self._result.shared if kind is SCALAR else self._result.each
        lines.append(f"const {kind} v{k} = {text};")
        self._slots[slot] = _Value(kind, f"v{k}")


def _literal(value: float) -> str:
    """A number as C text; in brackets, so that a sign can stand before it."""
    if math.isnan(value):
        return "NAN"
    return f"({math.copysign(1.0, value):.0f} * INFINITY)" if math.isinf(value) else f"({value!r})"


def _operation(operation: int, arguments: list[_Value]) -> tuple[str, str]:
    """Kind and C text of the result of one operation."""
    scalar = all(a.kind is SCALAR for a in arguments)
    if operation in _COMPARED:
        a, b = (a.number if scalar else a.vector for a in arguments)
        text = f"{a} {_COMPARED[operation]} {b}"
        return (SCALAR, text) if scalar else (MASK, f"TRUE_IF({text})")
    if operation in (ca.OP_IF_ELSE_ZERO, ca.OP_NOT, ca.OP_AND, ca.OP_OR):
        return _logical(operation, arguments, scalar)
    kind = SCALAR if scalar else VECTOR
    if operation in _INFIX:
        a, b = (a.number for a in arguments)
        return kind, f"{a} {_INFIX[operation]} {b}"
    if operation in _FORMULA:
        return kind, _FORMULA[operation].format(arguments[0].number)
    if operation in _CALLED:
        name = _CALLED[operation]
        called = name if scalar else _VECTOR_NAME.get(name, f"v_{name}")
        return kind, f"{called}({', '.join(a.number if scalar else a.vector for a in arguments)})"
    raise TranslationError(f"CasADi operation {operation} has no C translation")


def _logical(operation: int, arguments: list[_Value], scalar: bool) -> tuple[str, str]:
    names = [a.number if scalar else a.condition for a in arguments]
    if operation == ca.OP_IF_ELSE_ZERO:
        value = arguments[1]
        if scalar:
            return SCALAR, f"{names[0]} ? {value.number} : 0.0"
        return VECTOR, f"keep({names[0]}, {value.vector})"
    if operation == ca.OP_NOT:
        return (SCALAR, f"!{names[0]}") if scalar else (MASK, f"~{names[0]}")
    sign = "&" if operation == ca.OP_AND else "|"
    return (SCALAR, f"{names[0]} {sign * 2} {names[1]}") if scalar else (MASK, f"{names[0]} {sign} {names[1]}")


def nonzero_elements(outputs: dict[str, Any]) -> dict[str, list[tuple[int, int]]]:
    """Positions (row, column), column after column, of the elements that are not structurally zero."""
    found = {}
    for name, matrix in outputs.items():
        rows, columns = matrix.shape
        found[name] = [(i, j) for j in range(columns) for i in range(rows) if not matrix[i, j].is_zero()]
    return found

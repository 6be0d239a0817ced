"""Mutation run over the safety files: every small change of the code must make a test fail.

One mutant at a time, in a forked copy of a process that has everything imported: the changed module is put in
place before the tests import it. A survivor needs a reason, written in `EQUIVALENT` and checked to be still there.
"""

from __future__ import annotations

import ast
import copy
import importlib
import importlib.util
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from hil_gateway.process.errors import InputError

LIMITS, FAILSAFE = "hil_gateway.gateway.act.limits", "hil_gateway.gateway.decide.failsafe"
TARGETS: dict[str, tuple[str, ...]] = {
    LIMITS: ("tests/unit/hil_gateway/gateway/act/test_limits.py",),
    FAILSAFE: ("tests/unit/hil_gateway/gateway/decide/test_failsafe.py",),
    "can_dbc.codec": ("tests/unit/can_dbc/test_codec.py", "tests/property/test_codec_properties.py"),
}
"""Module -> the tests that must notice."""
PYTEST_OPTIONS = (
    "-x", "-q", "--assert=plain", "-p", "no:cacheprovider", "-o", "filterwarnings=ignore",
    "-m", "not vcan and not slow",
)  # fmt: skip
TIMEOUT_S = 90
"""A mutant that runs longer loops for ever: noticed."""
SLOWER = "the general path decodes the same values, only slower (benchmarks/codec.py sees it)"
EQUIVALENT: dict[tuple[str, str], str] = {
    (LIMITS, "50000.0 -> 50001.0 (constant)"): "rounded to the raw step of 1 kPa: the same integer",
    (LIMITS, "raw <= low -> raw < low (comparison)"): "at equality rounding gives the bound as well",
    (LIMITS, "raw >= high -> raw > high (comparison)"): "at equality rounding gives the bound as well",
    (
        LIMITS,
        "abs(want - got) <= 0.501 * limit.scale -> abs(want - got) < 0.501 * limit.scale (comparison)",
    ): "0.501 lies between rounding (at most 0.5) and a limit; equality has no meaning",
    ("can_dbc.codec", "if words is None: -> if True: (condition)"): SLOWER,
    ("can_dbc.codec", "if self._raw is None: -> if True: (condition)"): "compiled again at every use: slower",
    ("can_dbc.codec", "if not aligned: -> if True: (condition)"): SLOWER,
    ("can_dbc.codec", "8 -> 9 (constant)"): SLOWER,
    ("can_dbc.codec", "16 -> 17 (constant)"): SLOWER,
    ("can_dbc.codec", "32 -> 33 (constant)"): SLOWER,
    (
        "can_dbc.codec",
        "f'frame >> {shift}' if shift else 'frame' -> f'frame >> {shift}' if True else 'frame' (condition)",
    ): "a shift by 0 changes nothing",
    (
        "can_dbc.codec",
        "f' & {(1 << signal.length) - 1}' if shift + signal.length < dlc * 8 else '' -> "
        "f' & {(1 << signal.length) - 1}' if True else '' (condition)",
    ): "masking the topmost field changes nothing",
    (
        "can_dbc.codec",
        "shift + signal.length < dlc * 8 -> shift + signal.length <= dlc * 8 (comparison)",
    ): "masking the topmost field changes nothing",
    (
        "can_dbc.codec",
        "f'({value}) / {scale!r}' if offset else f'{value} / {scale!r}' if scale != 1.0 else value -> "
        "f'({value}) / {scale!r}' if True else f'{value} / {scale!r}' if scale != 1.0 else value (condition)",
    ): "parentheses around a single name, or a division by 1.0",
    (
        "can_dbc.codec",
        "f'{value} / {scale!r}' if scale != 1.0 else value -> f'{value} / {scale!r}' if True else value (condition)",
    ): "a division by 1.0",
    ("can_dbc.codec", "signal.shift(message.dlc) % 8 -> signal.shift(message.dlc) * 8 (operator)"): SLOWER,
    (
        "can_dbc.codec",
        "shift + signal.length -> shift - signal.length (operator)",
    ): "masking the topmost field changes nothing",
    (
        "can_dbc.codec",
        "f'(r{index} & {(1 << signal.length) - 1})' if signal.signed else f'r{index}' -> "
        "f'(r{index} & {(1 << signal.length) - 1})' if True else f'r{index}' (condition)",
    ): "an unsigned number has been held to its field before",
    (
        "can_dbc.codec",
        "f'{raw} << {shift}' if shift else raw -> f'{raw} << {shift}' if True else raw (condition)",
    ): "a shift by 0 changes nothing",
    (FAILSAFE, "1000 -> 1001 (constant)"): "documentation: thresholds are shown in whole milliseconds",
}
"""(module, change) of a survivor -> why no test can tell it from the original."""
DECLARATIONS = ("frozen", "slots", "strict")
"""Keyword arguments that forbid mistakes and change nothing in code that makes none."""

COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult, ast.LShift: ast.RShift, ast.RShift: ast.LShift, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip
NAMES = {"min": "max", "max": "min", "floor": "ceil", "ceil": "floor", "any": "all", "all": "any"}


@dataclass(frozen=True)
class Mutant:
    """One changed module."""

    module: str
    line: int
    description: str
    tree: ast.Module


def mutants(module: str, path: Path) -> Iterator[Mutant]:
    """Every single change of a module; docstrings, annotations and error texts are left alone."""
    original = ast.parse(path.read_text())
    declared = {
        id(node.value) for node in ast.walk(original) if isinstance(node, ast.keyword) and node.arg in DECLARATIONS
    }
    for number, node in enumerate(list(ast.walk(original))):
        if id(node) in declared:
            continue
        for variant, change in enumerate(_changes(node)):
            tree = copy.deepcopy(original)
            target = list(ast.walk(tree))[number]
            before = ast.unparse(target)
            list(_changes(target))[variant].apply(target)
            after = ast.unparse(target)
            if before != after:
                line = getattr(node, "lineno", 0)
                heads = f"{before.splitlines()[0]} -> {after.splitlines()[0]}"
                yield Mutant(module, line, f"line {line}: {heads} ({change.name})", tree)


@dataclass(frozen=True)
class _Change:
    name: str
    field: str
    value: Any
    index: int | None = None

    def apply(self, node: ast.AST) -> None:
        if self.index is None:
            setattr(node, self.field, self.value)
        else:
            getattr(node, self.field)[self.index] = self.value


def _changes(node: ast.AST) -> Iterator[_Change]:
    match node:
        case ast.Compare():
            for index, operator in enumerate(node.ops):
                yield _Change("comparison", "ops", COMPARISONS[type(operator)](), index)
        case ast.BinOp() if type(node.op) in OPERATORS and not _type(node):
            yield _Change("operator", "op", OPERATORS[type(node.op)]())
        case ast.BoolOp():
            yield _Change("and/or", "op", ast.Or() if isinstance(node.op, ast.And) else ast.And())
        case ast.UnaryOp(op=ast.Not()):
            yield _Change("not", "op", ast.UAdd())
        case ast.UnaryOp(op=ast.USub()):
            yield _Change("sign", "op", ast.UAdd())
        case ast.Constant(value=bool(truth)):
            yield _Change("constant", "value", not truth)
        case ast.Constant(value=int(number) | float(number)):
            yield _Change("constant", "value", number + 1)
        case ast.If() | ast.IfExp() | ast.While():
            yield _Change("condition", "test", ast.Constant(value=False))
            yield _Change("condition", "test", ast.Constant(value=True))
        case ast.Call(func=ast.Name(id=name)) if name in NAMES:
            yield _Change("function", "func", ast.Name(id=NAMES[name], ctx=ast.Load()))
        case ast.Call(func=ast.Attribute(value=of, attr=name)) if name in NAMES:
            yield _Change("function", "func", ast.Attribute(of, NAMES[name], ast.Load()))


def _type(node: ast.BinOp) -> bool:
    """Types like `int | None` or `Values | Fault` are no arithmetic."""
    if not isinstance(node.op, ast.BitOr):
        return False
    names = [side.id for side in (node.left, node.right) if isinstance(side, ast.Name)]
    constants = any(isinstance(side, ast.Constant | ast.Subscript) for side in (node.left, node.right))
    return constants or (len(names) == 2 and all(name[0].isupper() for name in names))


def run(root: Path, modules: tuple[str, ...] = tuple(TARGETS), every: int = 1) -> dict[str, Any]:
    """Run every (or every so many-th) mutant of `modules`; the report of `hil verify --mutation`.

    Raises:
        InputError: the tests fail without a mutant.
    """
    os.chdir(root)
    os.environ.setdefault("HIL_SHARE", "0.02")
    sys.path.insert(0, str(root / "tests"))
    _import_everything_else()
    started = time.perf_counter()
    survivors: list[str] = []
    counts: dict[str, dict[str, int]] = {}
    for module in modules:
        tests = TARGETS[module]
        path = root / (module.replace(".", "/") + ".py")
        original = Mutant(module, 0, "the original", ast.parse(path.read_text()))
        if _noticed(original, tests):
            raise InputError(f"{', '.join(tests)}: fails without any mutation; run it by itself first")
        noticed = total = 0
        for mutant in islice(mutants(module, path), 0, None, every):
            total += 1
            if _noticed(mutant, tests):
                noticed += 1
            else:
                survivors.append(f"{module} {mutant.description}")
                print(f"\rsurvived: {survivors[-1]}", file=sys.stderr)
            print(f"\r{module}: {total} mutants, {total - noticed} survived", end="", file=sys.stderr)
        print(file=sys.stderr)
        counts[module] = {"mutants": total, "noticed": noticed}
    unexplained = [text for text in survivors if _reason(text) is None]
    return {
        "ok": not unexplained,
        "counts": counts,
        "survivors": {text: _reason(text) for text in survivors},
        "unexplained": unexplained,
        "seconds": round(time.perf_counter() - started),
    }


def _reason(survivor: str) -> str | None:
    """Why a survivor is no fault of the tests; line numbers may have moved."""
    module, _, description = survivor.partition(" ")
    change = description.partition(": ")[2]
    return EQUIVALENT.get((module, change))


def _import_everything_else() -> None:
    """What the tests need and the mutants do not touch, once."""
    ours = ("hil_gateway.config", "can_dbc.database")
    for name in ("pytest", "hypothesis", "cantools", *ours, "numpy", "scipy"):
        importlib.import_module(name)


def _noticed(mutant: Mutant, tests: tuple[str, ...]) -> bool:
    """Run the tests with the mutant in a forked copy of this process."""
    pid = os.fork()
    if not pid:
        _run_child(mutant, tests)
    deadline = time.monotonic() + TIMEOUT_S
    while time.monotonic() < deadline:
        finished, status = os.waitpid(pid, os.WNOHANG)
        if finished:
            return os.waitstatus_to_exitcode(status) != 0
        time.sleep(0.01)
    os.kill(pid, 9)
    os.waitpid(pid, 0)
    return True


def _run_child(mutant: Mutant, tests: tuple[str, ...]) -> None:
    """Never returns; exit code 0 only when every test passed."""
    status = 1
    try:
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        _install(mutant)
        import hypothesis
        import pytest

        # a failing example is enough: nobody reads a small one
        hypothesis.settings.register_profile("noticing", phases=(hypothesis.Phase.explicit, hypothesis.Phase.generate))
        hypothesis.settings.load_profile("noticing")
        status = int(pytest.main([*PYTEST_OPTIONS, *tests]))
    finally:
        os._exit(status)


def _install(mutant: Mutant) -> None:
    """Put the mutant where the tests will find it; modules that imported the original are imported anew."""
    for name in [name for name in sys.modules if name.startswith(("hil_gateway.", "can_dbc.codec", "estimator"))]:
        del sys.modules[name]
    specification = importlib.util.find_spec(mutant.module)
    assert specification is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[mutant.module] = module
    code = compile(ast.fix_missing_locations(mutant.tree), f"<mutant of {mutant.module}>", "exec")
    exec(code, module.__dict__)
    parent, _, name = mutant.module.rpartition(".")
    setattr(importlib.import_module(parent), name, module)

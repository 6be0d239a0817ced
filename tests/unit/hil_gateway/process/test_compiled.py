"""Compiled CasADi functions: same numbers as the virtual machine, cached by content, usable without a compiler."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from hil_gateway.process import compiled
from hil_gateway.process.compiled import CompilerWarning, compile_function, find_compiler

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "hil-gateway"


def _function(gain: float = 2.0) -> ca.Function:
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p", 2)
    value = gain * ca.vertcat(ca.sin(x[0]) * p[0], x[1] ** 2, x[2] * p[1])
    return ca.Function("f", [x, p], [value, ca.jacobian(value, x)])


def _evaluate(f: compiled.CompiledFunction) -> tuple[np.ndarray, np.ndarray]:
    f.inputs[0][:, 0], f.inputs[1][:, 0] = (0.3, -1.2, 2.0), (1.5, -0.5)
    f()
    return f.outputs[0].copy(), f.outputs[1].copy()


@needs_compiler
def test_compiled_and_interpreted_agree(cache: Path) -> None:
    fast, slow = compile_function(_function()), compile_function(_function(), compiled=False)
    assert (fast.backend, slow.backend) == ("compiled", "vm")
    for a, b in zip(_evaluate(fast), _evaluate(slow), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14)
    reference = _function()([0.3, -1.2, 2.0], [1.5, -0.5])
    np.testing.assert_allclose(_evaluate(fast)[1], np.array(reference[1]), rtol=1e-14)


@needs_compiler
def test_exact_functions_have_the_bits_of_the_virtual_machine(cache: Path) -> None:
    P, F = ca.SX.sym("P", 6, 6), ca.SX.sym("F", 6, 6)
    function = ca.Function("f", [P, F], [F @ P @ F.T + ca.tanh(P)])
    fast, slow = compile_function(function, flags=compiled.EXACT), compile_function(function, compiled=False)
    for f in (fast, slow):
        for given in f.inputs:
            given[:] = np.sin(np.arange(36.0)).reshape(6, 6)
        f()
    np.testing.assert_array_equal(fast.outputs[0], slow.outputs[0])


@needs_compiler
def test_library_is_cached_by_content(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compile_function(_function())
    monkeypatch.setattr(compiled, "_build", lambda *_: pytest.fail("built twice"))
    compile_function(_function())
    monkeypatch.undo()
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache.parent))
    compile_function(_function(3.0))
    assert len(list(cache.glob("*.so"))) == 2


@needs_compiler
def test_two_that_want_the_same_library_at_once_build_it_once(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiler = tmp_path / "compiler"
    compiler.write_text(f'#!/bin/sh\necho >>{tmp_path}/built\nsleep 0.3\nexec {find_compiler()} "$@"\n')
    compiler.chmod(0o755)
    monkeypatch.setattr(compiled, "find_compiler", lambda: str(compiler))
    compiled._identity(str(compiler))
    (tmp_path / "built").unlink()
    with ThreadPoolExecutor(2) as both:
        found = set(both.map(compiled.compile_source, ["int answer(void) { return 42; }"] * 2))
    assert found == set(cache.glob("*.so"))
    assert (tmp_path / "built").read_text() == "\n"


@needs_compiler
def test_damaged_cache_entry_is_rebuilt(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compile_function(_function())
    (library,) = cache.glob("*.so")
    damaged = tmp_path / "other" / "hil-gateway" / library.name
    damaged.parent.mkdir(parents=True)
    damaged.write_bytes(b"\x7fELF truncated")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "other"))
    assert compile_function(_function()).backend == "compiled"
    assert damaged.stat().st_size == library.stat().st_size


def test_without_a_compiler_it_runs_interpreted_and_says_so(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "find_compiler", lambda: None)
    with pytest.warns(CompilerWarning, match="no C compiler"):
        f = compile_function(_function())
    assert f.backend == "vm"
    assert _evaluate(f)[0][1, 0] == pytest.approx(2.88)


@needs_compiler
def test_failing_compiler_falls_back_with_its_message(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "FLAGS", ("--no-such-flag",))
    with pytest.warns(CompilerWarning, match="no-such-flag"):
        assert compile_function(_function()).backend == "vm"


@needs_compiler
def test_call_writes_in_place(cache: Path) -> None:
    f = compile_function(_function())
    before = f.outputs[0]
    _evaluate(f)
    f.inputs[1][0, 0] = 0.0
    f()
    assert f.outputs[0] is before
    assert before[0, 0] == 0.0

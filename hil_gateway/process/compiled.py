"""CasADi functions compiled by the machine's C compiler at run time, called without allocation.

`Function.generate` writes plain C; gcc turns it into a shared library once, which is kept in the user's cache
directory under the hash of source, compiler and flags. Without a compiler the same call runs in CasADi's virtual
machine, several times slower, and a warning says so. Inputs and outputs are numpy arrays allocated once: a call
reads and writes them in place (`Function.buffer`), which costs about 1 us instead of about 50 us for CasADi's own call.
"""

from __future__ import annotations

import ctypes
import fcntl
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from hil_gateway.process.arrays import Array
from hil_gateway.process.cache import cache_directory

FLAGS = ("-O2", "-march=native", "-fno-math-errno", "-shared", "-fPIC")
"""No -ffast-math: NaN must survive, it is how a broken step is recognised. -O3 compiles longer and is no faster."""
EXACT = ("-O1", "-ffp-contract=off", "-fno-math-errno", "-shared", "-fPIC")
"""The bits of the virtual machine on every computer: no product is fused with a sum."""
EXACT_LOOPS = ("-O3", *EXACT[1:])
"""The same for short code with loops (of `ca.MX`): what runs once a period comes from cold caches, where its length
counts for more than its operations."""

COMPILE_TIMEOUT_S = 120.0


class CompilerWarning(UserWarning):
    """Code that could be compiled runs slower, interpreted."""


@cache
def find_compiler() -> str | None:
    """C compiler: $CC, else gcc, else cc; `CC=none` asks for the virtual machine."""
    if name := os.environ.get("CC"):
        return shutil.which(name)
    return shutil.which("gcc") or shutil.which("cc")


@cache
def _identity(compiler: str) -> str:
    """Compiler version and processor: what a cached library depends on besides its source."""
    version = subprocess.run([compiler, "--version"], capture_output=True, text=True, check=False, timeout=10).stdout
    return "\n".join((version, platform.machine(), _processor()))


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.startswith(("flags", "Features"))), "")


def compile_source(
    source: str, libraries: tuple[str, ...] = ("-lm",), flags: tuple[str, ...] | None = None
) -> Path | None:
    """Shared library of a C source, from the cache or freshly built; None (with a warning) where that fails."""
    compiler = find_compiler()
    if compiler is None:
        warnings.warn("no C compiler found: functions run interpreted; install gcc", CompilerWarning, stacklevel=2)
        return None
    flags = FLAGS if flags is None else flags
    content = "\n".join((source, _identity(compiler), *flags, *libraries))
    path = cache_directory() / f"{hashlib.sha256(content.encode()).hexdigest()[:32]}.so"
    try:
        return path if path.exists() else _build(compiler, source, flags, libraries, path)
    except (OSError, subprocess.SubprocessError) as error:
        detail = getattr(error, "stderr", None) or str(error)
        warnings.warn(f"{compiler} failed, functions run interpreted: {detail[:400]}", CompilerWarning, stacklevel=2)
        return None


def _build(compiler: str, source: str, flags: tuple[str, ...], libraries: tuple[str, ...], path: Path) -> Path:
    """Compile beside the target and rename: another process sees all of the library or none of it, and one that wants
    the same waits instead of building it, too."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.with_suffix(".lock").open("w") as lock, tempfile.TemporaryDirectory(dir=path.parent) as directory:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if path.exists():
            return path
        code, library = Path(directory) / "code.c", Path(directory) / "code.so"
        code.write_text(source)
        command = [compiler, *flags, "-o", str(library), str(code), *libraries]
        subprocess.run(command, check=True, capture_output=True, text=True, timeout=COMPILE_TIMEOUT_S)
        library.replace(path)
    return path


def compile_library(function: ca.Function, flags: tuple[str, ...] | None = None) -> Path | None:
    """Library of a function with dense arguments, from the cache or freshly built; a damaged one is built anew."""
    generator = ca.CodeGenerator(f"{function.name()}.c")
    generator.add(function)
    source = generator.dump()
    path = compile_source(source, flags=flags)
    if path is None:
        return None
    try:
        ctypes.CDLL(str(path))
    except OSError:
        path.unlink(missing_ok=True)
        path = compile_source(source, flags=flags)
    return path


class CompiledFunction:
    """One CasADi function with preallocated dense arguments.

    `inputs` and `outputs` are arrays in column-major order shaped as the function's; write into an input, `evaluate`
    (or call), read an output. `arguments` and `results` are the same memory, vectors with one dimension. An instance
    serves one thread.
    """

    def __init__(self, function: ca.Function, backend: str) -> None:
        self.function = function
        self.backend = backend
        self.inputs: tuple[Array, ...] = tuple(np.zeros(function.size_in(i), order="F") for i in range(function.n_in()))
        self.outputs: tuple[Array, ...] = tuple(
            np.zeros(function.size_out(i), order="F") for i in range(function.n_out())
        )
        self.arguments, self.results = (tuple(map(_plain, arrays)) for arrays in (self.inputs, self.outputs))
        self._buffer, self.evaluate = self._bind(function)

    def _bind(self, function: ca.Function) -> tuple[Any, Callable[[], None]]:
        buffer: Any
        buffer, evaluate = function.buffer()
        for i, array in enumerate(self.inputs):
            buffer.set_arg(i, _flat(array))
        for i, array in enumerate(self.outputs):
            buffer.set_res(i, _flat(array))
        return buffer, evaluate

    def twin(self) -> CompiledFunction:
        """The same function with arrays of its own."""
        return CompiledFunction(self.function, self.backend)

    def __call__(self) -> None:
        """Evaluate from `inputs` into `outputs`."""
        self.evaluate()


def _plain(array: Array) -> Array:
    """View of an array, of one dimension where it is a column."""
    return array[:, 0] if array.shape[1] == 1 else array


def _flat(array: Array) -> Any:
    """Writable view of a column-major array in memory order."""
    return array.reshape(-1, order="F").data


def compile_function(
    function: ca.Function, compiled: bool = True, flags: tuple[str, ...] | None = None
) -> CompiledFunction:
    """Compile `function`, or wrap it interpreted where there is no compiler (warning) or `compiled` is False.

    Sparse arguments become dense, so that every array has its full shape.
    """
    dense = densified(function)
    path = compile_library(dense, flags) if compiled else None
    return CompiledFunction(dense, "vm") if path is None else load_function(function.name(), path)


def load_function(name: str, path: Path) -> CompiledFunction:
    """Function `name` of a library built before, possibly by another process: no symbolic work, milliseconds."""
    return CompiledFunction(ca.external(name, str(path)), "compiled")


def densified(function: ca.Function) -> ca.Function:
    """The same function with dense inputs and outputs."""
    names_in, names_out = function.name_in(), function.name_out()
    if all(function.sparsity_in(i).is_dense() for i in range(function.n_in())) and all(
        function.sparsity_out(i).is_dense() for i in range(function.n_out())
    ):
        return function
    symbol: Any = ca.SX if function.is_a("SXFunction") else ca.MX
    arguments: list[Any] = [symbol.sym(name, *function.size_in(i)) for i, name in enumerate(names_in)]
    results = [ca.densify(result) for result in function.call(arguments)]
    return ca.Function(function.name(), arguments, results, names_in, names_out)

"""CasADi functions compiled at run time; the plant uses the same compiler, so it lives in `hil_gateway.compiled`."""

from __future__ import annotations

from hil_gateway.compiled import (
    CompiledFunction,
    CompilerWarning,
    compile_function,
    compile_library,
    compile_source,
    densified,
    find_compiler,
    load_function,
)

__all__ = [
    "CompiledFunction",
    "CompilerWarning",
    "compile_function",
    "compile_library",
    "compile_source",
    "densified",
    "find_compiler",
    "load_function",
]

"""CasADi functions compiled at run time, as the plant compiles its own: `hil_gateway.process.compiled`."""

from __future__ import annotations

from hil_gateway.process.compiled import (
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

"""The compiled functions of one optimal-control problem, built here or by a process beside this one.

A new list of active effects needs new functions. Building them is a second or two of symbolic work and gcc, most
of it holding Python's lock; so it happens in a child process, and the planner loads the finished libraries.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from estimator.model.effects import catalogue
from estimator.model.single_track import SingleTrack
from hil_gateway.car.powertrain import Powertrain
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.compiled import (
    COMPILE_TIMEOUT_S,
    CompiledFunction,
    compile_function,
    compile_library,
    densified,
    load_function,
)
from hil_gateway.process.model import Model
from planner.problem.brake_law import BrakeLaw
from planner.problem.checked_motion import CheckedMotion
from planner.problem.mpcc import Problem
from planner.problem.settings import Information, PlanLimits, Settings, Slack, Weights
from planner.solver.fixed import FixedHorizon, build_library
from planner.solver.fixed_check import FixedCheck, build_check


@dataclass(frozen=True)
class Functions:
    """`horizon`: QP blocks of all stages; `step`: one interval of motion; `advance`: a short time with held inputs;
    `checked`: every limit of a plan once more (`CheckedMotion`).

    `information`: F_k of Eq. (7) of all stages, where the D-criterion needs it. `library`: the generated solver,
    where there is a compiler and it passed its self-test.
    """

    horizon: CompiledFunction | FixedHorizon
    step: CompiledFunction
    advance: CompiledFunction
    checked: CompiledFunction | FixedCheck
    information: CompiledFunction | None = None
    library: Path | None = None


def _symbolic(problem: Problem) -> dict[str, Any]:
    """All but the stage functions and the check, which are generated on stages side by side."""
    functions = {"step": problem.step_function(), "advance": problem.advance_function()}
    if problem.informative and problem.settings.information.criterion == "log_det":
        functions["information"] = problem.information_function()
    return functions


def build_functions(problem: Problem, compiled: bool = True) -> Functions:
    """Build in this process; interpreted where there is no compiler."""
    if compiled and all((paths := libraries(_describe(problem))).values()):
        return _loaded(problem, paths)
    library = build_library(problem) if compiled else None
    check = build_check(*_check_of(problem)) if compiled else None
    others = {name: compile_function(f, compiled) for name, f in _symbolic(problem).items()}
    return Functions(
        horizon=FixedHorizon(library, problem) if library else compile_function(problem.horizon_function(), compiled),
        checked=FixedCheck(check, *_check_of(problem)) if check else _plain_check(problem, compiled),
        **others, library=library,
    )  # fmt: skip


def _check_of(problem: Problem) -> tuple[CheckedMotion, int]:
    """The check of a problem's plans, and how many stages they have."""
    settings = problem.settings
    return CheckedMotion(problem.model, settings.load_limit == "literal", settings.brakes), settings.horizon + 1


def _plain_check(problem: Problem, compiled: bool) -> CompiledFunction:
    """As CasADi generates it, one stage after the other, or interpreted."""
    motion, stages = _check_of(problem)
    return compile_function(motion.function(stages), compiled)


def build_in_child(problem: Problem) -> Functions:
    """Build in a child process and load the result; blocks until it is there (call from a worker thread).

    Raises:
        RuntimeError: the child failed; its message.
    """
    command = [sys.executable, "-m", "planner.solver.functions"]
    try:
        child = subprocess.run(
            command, input=_describe(problem), capture_output=True, text=True, timeout=COMPILE_TIMEOUT_S, check=False
        )
    except (OSError, subprocess.SubprocessError) as error:
        raise RuntimeError(f"cannot build the planner's functions: {error}") from None
    if child.returncode:
        raise RuntimeError(f"cannot build the planner's functions: {child.stderr.strip()[-400:]}")
    paths: dict[str, str | None] = json.loads(child.stdout)
    if not all(paths.values()):
        return build_functions(problem)  # interpreted functions cannot be handed over
    return _loaded(problem, paths)


@cache
def libraries(description: str) -> dict[str, str | None]:
    """Libraries of a problem as `_describe` says it, by name of the function; None where one cannot be built."""
    problem = _restore(description)
    paths = {name: compile_library(densified(f)) for name, f in _symbolic(problem).items()}
    paths |= {"library": build_library(problem), "check": build_check(*_check_of(problem))}
    return {name: None if path is None else str(path) for name, path in paths.items()}


def _loaded(problem: Problem, paths: Mapping[str, str | None]) -> Functions:
    known = {name: Path(str(path)) for name, path in paths.items()}
    library, check = known.pop("library"), known.pop("check")
    others = {name: load_function(name, path) for name, path in known.items()}
    checked = FixedCheck(check, *_check_of(problem))
    return Functions(FixedHorizon(library, problem), checked=checked, **others, library=library)


def _describe(problem: Problem) -> str:
    model = problem.model
    return json.dumps({
        "vehicle": model.vehicle.model_dump(), "effects": [e.name for e in model.effects],
        "tyre_prior": dict(model.tyre_prior), "settings": asdict(problem.settings),
    }, default=Model.model_dump)  # fmt: skip


def _restore(text: str) -> Problem:
    data = json.loads(text)
    settings = data["settings"]
    for name, kind in (("weights", Weights), ("limits", PlanLimits), ("slack", Slack), ("information", Information)):
        settings[name] = kind(**settings[name])
    law = settings["brakes"]
    settings["brakes"] = BrakeLaw(Vehicle(**law["vehicle"]), Powertrain(**law["powertrain"]))
    effects = tuple(catalogue()[name] for name in data["effects"])
    model = SingleTrack(Vehicle(**data["vehicle"]), data["tyre_prior"], effects)
    return Problem(model, Settings(**settings))


def _main() -> None:
    """Child process: problem on standard input, paths of the libraries on standard output.

    It gives way to whoever drives meanwhile, and so does the compiler it starts.
    """
    os.nice(19)
    print(json.dumps(libraries(sys.stdin.read())))


if __name__ == "__main__":
    _main()

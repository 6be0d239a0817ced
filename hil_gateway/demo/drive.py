"""One drive: set up, run, measured, summarised."""

from __future__ import annotations

import contextlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from hil_gateway.demo.folder import CONFIG_NAME
from hil_gateway.demo.options import DemoOptions, DemoSetup, prepare
from hil_gateway.demo.run import Ending, Run, RunResult
from hil_gateway.demo.summary import summarise
from hil_gateway.demo.view import LiveView, PlainView, View
from hil_gateway.plant.plant import plant_parameters
from hil_gateway.plant.referee.lap_limit import lap_limit
from hil_gateway.process.children import ask
from hil_gateway.process.errors import InputError
from hil_gateway.process.lifecycle import StopRequest
from hil_gateway.process.supervisor import DASHBOARD, LEARNER, PROCESSES, RECEIVER, ProcessSpec, Supervisor
from hil_gateway.track.loading import load_track


def drive(options: DemoOptions) -> dict[str, Any]:
    """Drive as asked; the summary.

    Raises:
        InputError: something a user got wrong.
    """
    setup = prepare(options)
    say(f"CAN bus: {setup.bus}; session: {setup.session}")
    with setup.lock:
        result = _run(options, setup)
        # who interrupts does not want to wait, and without a lap there is nothing to hold against it
        limit_s = _limit_s(setup) if result.ending is Ending.DONE and result.referee.laps else None
        return summarise(options, setup, result, _model_error(setup, result), limit_s)


def say(text: str) -> None:
    """Progress, on standard error."""
    print(text, file=sys.stderr, flush=True)


def _model_error(setup: DemoSetup, result: RunResult) -> dict[str, Any]:
    if result.ending is not Ending.DONE:  # who interrupts does not want to wait
        return unknown(f"the run ended early: {result.ending.value}")
    say("measuring the model error on the recording")
    return measure(setup.session)


def _run(options: DemoOptions, setup: DemoSetup) -> RunResult:
    stopping = StopRequest()
    asked = ((DASHBOARD, options.dashboard), (LEARNER, options.learner), (RECEIVER, bool(setup.config.receivers)))
    further = [spec for spec, wanted in asked if wanted]
    specs = [_with_arguments(spec, options, setup) for spec in (*PROCESSES, *further)]
    if options.dashboard:
        say(f"dashboard: http://{setup.config.dashboard.host}:{setup.config.dashboard.port}/")
    view = _view(options, setup)
    with contextlib.closing(view), Supervisor(setup.config_file, setup.folder / "logs", specs) as supervisor:
        supervisor.start(stage=0)
        run = Run(options, setup, supervisor, view, stopping)
        result = run.drive()
    run.close()
    stopping.release()  # nothing drives any more: what is still measured may be broken off
    return result


def _with_arguments(spec: ProcessSpec, options: DemoOptions, setup: DemoSetup) -> ProcessSpec:
    """What only one process may know: the plant the file of the simulated car, the page that car's lap limit."""
    if spec.name == "plant" and options.car:
        return replace(spec, arguments=("--car", str(options.car.absolute())))
    if spec is DASHBOARD and (limit_s := _limit_s(setup)):
        return replace(spec, arguments=("--lap-limit", f"{limit_s:g}"))
    return spec


def _limit_s(setup: DemoSetup) -> float | None:
    """The least lap time of the simulated car, by the plant's equations; None where it cannot be found."""
    say("computing the least lap time of the simulated car; of a new car or track it takes half a minute")
    parameters = setup.car.parameters() if setup.car else plant_parameters(setup.config.plant)
    try:
        return lap_limit(parameters, load_track(setup.config.track)).limit_s
    except InputError as error:
        say(str(error))
        return None


def _view(options: DemoOptions, setup: DemoSetup) -> View:
    if options.headless or not sys.stderr.isatty():
        return PlainView()
    return LiveView(load_track(setup.config.track))


FIGURE = "position"
"""channel that stands for the others: m after one second of open-loop prediction"""


def measure(session: Path) -> dict[str, Any]:
    """`before` and `after`, m, on the session of a drive; null with a `reason` where they could not be measured.

    The revision the session began with and the one it had learnt, on its last third.
    """
    arguments = ["estimator", "score", str(session), "--config", str(session.with_name(CONFIG_NAME))]
    answer = ask(arguments)
    if answer.reason:
        return unknown(answer.reason)
    score = answer.content
    return {
        "before": score["before"][FIGURE],
        "after": score["after"][FIGURE],
        "unit": f"m, position after {score['horizon_s']:g} s of open-loop prediction, last third of the session",
        "channels": {
            name: {"before": score["before"][name], "after": score["after"][name]} for name in score["before"]
        },
        "revisions": score["revisions"],
        "windows": score["windows"],
    }


def unknown(reason: str) -> dict[str, Any]:
    """The result where nothing could be measured."""
    return {"before": None, "after": None, "reason": reason}

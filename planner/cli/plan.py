"""`hil plan bench`: the planner in closed loop on the model."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from hil_gateway.cli.laboratory import laboratory
from hil_gateway.config import Backend, load_config
from hil_gateway.process.errors import EXIT_FAILURE
from hil_gateway.process.figures import lines, print_json

app = typer.Typer(no_args_is_help=True, help="Planner benchmark in closed loop on the model.")


@app.callback()
def _group() -> None:
    """Planner benchmark in closed loop on the model."""


@app.command()
def bench(  # noqa: PLR0917 - options of a command line
    track: Annotated[str, typer.Option(help="track file or shipped track; default: the road course")] = "",
    laps: Annotated[int, typer.Option(min=1, help="flying laps to drive")] = 1,
    information: Annotated[Literal["on", "off"], typer.Option(help="Eq. (9) or the plain MPCC")] = "off",
    weight: Annotated[float | None, typer.Option(min=0, help="q_I with information on")] = None,
    backend: Annotated[Backend, typer.Option(help="QP solver")] = "auto",
    compiler: Annotated[bool, typer.Option(help="compile the stage functions")] = True,
    ipopt: Annotated[bool, typer.Option(help="solve some of the same problems with warm-started IPOPT")] = True,
    config: Annotated[Path | None, typer.Option(help="configuration (TOML)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False,
) -> None:
    """Drive laps on the planner's own model and report timings and safety figures."""
    from hil_gateway.plant.plant import plant_parameters
    from hil_gateway.plant.referee.lap_limit import lap_limit, lap_ratios
    from hil_gateway.track.loading import load_track
    from planner.problem.settings import settings_of

    b = laboratory("plans.bench")
    loaded = load_config(config, {"track": track} if track else None)
    settings = settings_of(loaded)
    if information == "on":
        q_i = b.INFORMATION_WEIGHT if weight is None else weight
        settings = replace(settings, information=replace(settings.information, weight=q_i))
    controller, _ = b.bench_controller(
        load_track(loaded.track), loaded.vehicle, settings, backend=backend, compiled=compiler
    )
    run = b.drive(controller, laps, ipopt=ipopt)
    result = b.summary(run, controller)
    limit_s = lap_limit(plant_parameters(loaded.plant), load_track(loaded.track)).limit_s
    result |= {"limit_s": limit_s, "lap_ratio": lap_ratios(run.lap_times_s, limit_s)}
    _print(result, as_json)
    if result["laps"] < laps or any(run.violations.values()):
        raise typer.Exit(EXIT_FAILURE)


@app.command()
def solver(
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False,
) -> None:
    """Say which QP solver plans are made with on this machine, and which is behind it."""
    from planner.solver.choice import solvers_here

    _print(asdict(solvers_here()), as_json)


@app.command()
def safety(  # noqa: PLR0917 - options of a command line
    track: Annotated[str, typer.Option(help="track file or shipped track; default: the road course")] = "",
    laps: Annotated[int, typer.Option(min=1)] = 10,
    mismatch: Annotated[float, typer.Option(min=0, max=0.5, help="relative error of every tyre parameter")] = 0.1,
    seed: Annotated[int, typer.Option(help="signs of the errors")] = 1,
    information: Annotated[Literal["on", "off"], typer.Option(help="Eq. (9) or the plain MPCC")] = "off",
    config: Annotated[Path | None, typer.Option(help="configuration (TOML)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False,
) -> None:
    """Drive laps on the simulated car with a wrong model and count violations of any limit."""
    from planner.plan.exploring import exploring

    s = laboratory("plans.safety")
    loaded = load_config(config, {"track": track} if track else None)
    result = s.drive(exploring(loaded) if information == "on" else loaded, laps, mismatch, seed)
    _print(result, as_json)
    if result["laps"] < laps or any(result["violations"].values()):
        raise typer.Exit(EXIT_FAILURE)


@app.command()
def limit(
    track: Annotated[str, typer.Option(help="track file or shipped track; default: the road course")] = "",
    car: Annotated[Path | None, typer.Option(help="simulated car (JSON); default: the realistic one")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False,
) -> None:
    """Least lap time of the simulated car by its own equations; for the referee, never for what drives."""
    from hil_gateway.plant.car_file import SimulatedCar, read_car
    from hil_gateway.plant.referee.lap_limit import limit_report
    from hil_gateway.track.loading import load_track

    simulated = read_car(car) if car else SimulatedCar()
    _print(limit_report(simulated.parameters(), load_track(track)), as_json)


@app.command()
def contraction(
    track: Annotated[str, typer.Option(help="track file or shipped track; default: the road course")] = "",
    places: Annotated[int, typer.Option(min=2, help="places around the lap")] = 24,
    config: Annotated[Path | None, typer.Option(help="configuration (TOML)")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False,
) -> None:
    """Measure where SQP steps and neighbouring drives contract, with and without the bound on Delta I."""
    compare = laboratory("plans.contraction").compare
    _print(compare(load_config(config, {"track": track} if track else None), places), as_json)


def _print(result: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print_json(result)
    else:
        print("\n".join(lines(result)))

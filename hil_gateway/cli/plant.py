"""`hil plant`: the simulated car as a process, and the table of its effects."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(no_args_is_help=True, help="The simulated AV-24 at the other end of the CAN cable.")


def parse_effects(texts: list[str]) -> dict[str, float]:
    """["aero_drag=0.6"] -> {"aero_drag": 0.6}.

    Raises:
        InputError: not of the form NAME=SIZE with a number, an unknown name, or a size outside its range.
    """
    from hil_gateway.plant.physics.effects import configure
    from hil_gateway.process.errors import InputError

    effects = {}
    for text in texts:
        name, _, size = text.partition("=")
        try:
            effects[name.strip()] = float(size)
        except ValueError:
            raise InputError(f"--effect {text}: write NAME=SIZE with a number, as aero_drag=0.6") from None
    configure(effects=effects)
    return effects


@app.command()
def run(  # noqa: PLR0917 - options of a command line
    config: Annotated[Path | None, typer.Option(help="TOML configuration")] = None,
    track: Annotated[str, typer.Option(help="track file or name of a shipped track")] = "",
    effect: Annotated[list[str] | None, typer.Option(help="NAME=SIZE, see `hil plant effects`")] = None,
    base: Annotated[str, typer.Option(help="av24 (realistic) or paper (Eq. 1-3)")] = "",
    seed: Annotated[int | None, typer.Option(help="seed of all sensor noise")] = None,
    car: Annotated[Path | None, typer.Option(help="simulated car (JSON), in place of base and effects")] = None,
) -> None:
    """Drive the simulated car on the CAN bus of the configuration until stopped."""
    from hil_gateway.config import load_config
    from hil_gateway.plant.car_file import read_car
    from hil_gateway.plant.node import run_plant
    from hil_gateway.process.errors import InputError

    if car and (effect or base):
        raise InputError(f"--car {car}: has base and effects in the file; leave out --effect and --base")

    overrides: dict[str, Any] = {f"plant.effects.{name}": size for name, size in parse_effects(effect or []).items()}
    given = {"track": track, "plant.base": base, "plant.seed": seed}
    overrides |= {key: value for key, value in given.items() if value not in ("", None)}
    run_plant(load_config(config, overrides), read_car(car) if car else None)


@app.command()
def effects(json: Annotated[bool, typer.Option("--json", help="one JSON object on standard output")] = False) -> None:
    """List the effects that can be switched, with unit and range of their size."""
    from hil_gateway.plant.physics.effects import SWITCHES

    if json:
        import json as encoder

        rows = {n: {"unit": s.unit, "meaning": s.meaning, "range": [s.low, s.high]} for n, s in SWITCHES.items()}
        typer.echo(encoder.dumps(rows))
        return
    for name, switch in SWITCHES.items():
        typer.echo(f"{name:20} {switch.low:>8g} .. {switch.high:<8g} {switch.unit:10} {switch.meaning}")

"""`hil learner`: diagnosis in the background while the car drives."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil_gateway.config import load_config

ABOUT = "Diagnosis beside the drive: proposes models with effects."

app = typer.Typer(no_args_is_help=True, help=ABOUT)


@app.callback(help=ABOUT)
def _group() -> None:
    """Keeps `run` a sub-command, as with every process."""


@app.command()
def run(config: Annotated[Path | None, typer.Option(help="configuration (TOML)")] = None) -> None:
    """Collect laps, diagnose them at low priority, propose models that predict a held-out lap better."""
    from estimator.learner.node import run as run_node

    run_node(load_config(config))

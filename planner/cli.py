"""`hil planner run`: the planner process."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil_gateway.config import load_config

app = typer.Typer(no_args_is_help=True, help="Infomax MPCC: plans and commands.")


@app.callback()
def _group() -> None:
    """Infomax MPCC: plans and commands."""


@app.command()
def run(
    config: Annotated[Path | None, typer.Option(help="configuration (TOML)")] = None,
    model: Annotated[str, typer.Option(help="model revision (JSON) to start from")] = "",
) -> None:
    """Plan from the newest estimate and send commands until interrupted."""
    from planner.node import run as run_node

    run_node(load_config(config, {"planner.model": model} if model else None))

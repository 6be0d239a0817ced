"""`hil estimator run`: the estimator process."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil_gateway.config import load_config

app = typer.Typer(no_args_is_help=True, help="State, tyre belief and model revisions.")


@app.callback()
def _group() -> None:
    """State, tyre belief and model revisions."""


@app.command()
def run(
    config: Annotated[Path | None, typer.Option(help="configuration (TOML)")] = None,
    model: Annotated[str, typer.Option(help="model revision (JSON) to start from")] = "",
) -> None:
    """Estimate the state, learn the tyres, publish model revisions until interrupted."""
    from estimator.node import run as run_node

    run_node(load_config(config, {"estimator.model": model} if model else None))

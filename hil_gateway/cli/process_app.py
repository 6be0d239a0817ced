"""Sub-commands that every process with a vehicle model has in common."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from hil_gateway.config import load_config


def process_app(section: str, node: str, about: str, run_help: str) -> typer.Typer:
    """A group with the command `run`, to which further commands may be added.

    Args:
        section: of the configuration; its `model` is what `--model` sets.
        node: module whose `run(config)` is the process; imported only when it is run.
        about: help of the group.
        run_help: help of `run`.
    """
    app = typer.Typer(no_args_is_help=True, help=about)
    app.callback(help=about)(_group)

    @app.command(help=run_help)
    def run(
        config: Annotated[Path | None, typer.Option(help="configuration (TOML)")] = None,
        model: Annotated[str, typer.Option(help="model revision (JSON) to start from")] = "",
    ) -> None:
        import_module(node).run(load_config(config, {f"{section}.model": model} if model else None))

    return app


def _group() -> None:
    """Keeps `run` a sub-command where it is the only one."""

"""What groups of commands have in common: their help, and the sub-command of a process with a vehicle model."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

LONGEST_SENTENCE = 200
"""characters: what a command does is one sentence"""


class Group(TyperGroup):
    """Lists its commands in whole sentences; typer's own list breaks them off where its line ends."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        rows = [(name, self.commands[name].get_short_help_str(LONGEST_SENTENCE)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


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
        from hil_gateway.config import load_config

        import_module(node).run(load_config(config, {f"{section}.model": model} if model else None))

    return app


def _group() -> None:
    """Keeps `run` a sub-command where it is the only one."""

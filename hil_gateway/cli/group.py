"""A group of commands, as `hil GROUP --help` lists them."""

from __future__ import annotations

from typing import Any

from typer.core import TyperGroup

LONGEST_SENTENCE = 200
"""characters: what a command does is one sentence"""


class Group(TyperGroup):
    """Lists its commands in whole sentences; typer's own list breaks them off where its line ends."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        rows = [(name, self.commands[name].get_short_help_str(LONGEST_SENTENCE)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

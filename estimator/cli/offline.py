"""What `hil identify` and `hil diagnose` share: the options that name a data set, and a progress bar."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil_gateway.process.writable import check_folder

if TYPE_CHECKING:
    from estimator.drive_log.table import DriveLog

Bar = Callable[[str, float], None]
"""(what is done, share that is behind)"""

Sessions = Annotated[list[Path], typer.Argument(help="recorded .mcap or drive-log .csv files: one data set")]
Columns = Annotated[
    Path | None, typer.Option("--columns", help="map of the columns (TOML), as `hil session columns` proposes it")
]
VehicleFile = Annotated[Path | None, typer.Option(help="vehicle JSON; default: the car's")]
TyreFile = Annotated[Path | None, typer.Option(help="tyre prior JSON; default: the car's")]
AsJson = Annotated[bool, typer.Option("--json", help="one JSON object on standard output")]


def read_data_set(sessions: list[Path], columns: Path | None) -> DriveLog:
    """The files as one log, its columns as the map says.

    Raises:
        InputError: a file that cannot be read or used.
    """
    from estimator.drive_log.column_map import read_map
    from estimator.drive_log.table import read_logs

    return read_logs(sessions, None if columns is None else read_map(columns))


def check_results(out: Path | None, results: tuple[str, ...], inputs: list[Path | None]) -> None:
    """Before hours of work: the folder takes `results`, and none of them replaces an input.

    Raises:
        InputError: it does not.
    """
    if out is not None:
        check_folder(out, results, [path for path in inputs if path is not None])


@contextmanager
def progress_bar() -> Iterator[Bar]:
    """Progress bar on standard error that says what is done; silent where that is no terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (BarColumn(20), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=1.0)
        yield lambda what, share: bar.update(task, description=what, completed=share)

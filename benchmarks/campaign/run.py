"""Drives the trials of a campaign that are not stored yet: worker processes of this machine, or a dask cluster."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from hil_gateway.process.children import pool
from hil_gateway.process.errors import InputError

T = TypeVar("T")


@dataclass(frozen=True)
class Job:
    """One drive of a campaign: `drive()` gives its result, plain data with `settings` in it.

    `name` is that of the result's file; a stored result counts while its settings are the same.
    """

    name: str
    settings: Mapping[str, Any]
    drive: Callable[[], dict[str, Any]]


@dataclass(frozen=True)
class Machines:
    """Where to drive: that many processes here, or the dask scheduler at an address."""

    processes: int
    scheduler: str = ""


def drive_all(jobs: Sequence[Job], out: Path, machines: Machines) -> list[dict[str, Any]]:
    """All results in the order of the jobs, from the folder or driven now.

    Raises:
        InputError: a cluster is asked for and dask is missing.
    """
    if machines.scheduler and find_spec("distributed") is None:
        raise InputError("--scheduler needs dask: pip install 'hil-gateway[cluster]'")
    found: dict[str, dict[str, Any] | None] = {job.name: load(out, job.name, job.settings) for job in jobs}
    missing = [job for job in jobs if found[job.name] is None]
    run = _on_cluster if machines.scheduler else _here
    done = len(jobs) - len(missing)
    for name, driven in with_bar(run(missing, machines), len(jobs), lambda named: f"driven {named[0]}", done):
        save(out, name, driven)
        found[name] = driven
    return [stored for job in jobs if (stored := found[job.name]) is not None]


def with_bar(
    results: Iterable[T], total: int, describe: Callable[[T], str], done: int = 0, forks: bool = False
) -> Iterator[T]:
    """The results as they come, beside a bar on standard error that says how many of `total` there are.

    Where the process `forks` for its results, the bar is drawn with every result only: a thread that draws it could
    leave a lock behind in the copy.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(file=sys.stderr), auto_refresh=not forks) as progress:
        task = progress.add_task("driving", total=total, completed=done)
        for result in results:
            yield result
            progress.update(task, advance=1, description=describe(result), refresh=forks)


def _here(jobs: Sequence[Job], machines: Machines) -> Iterator[tuple[str, dict[str, Any]]]:
    """Results as they finish."""
    if not jobs:
        return
    with pool(machines.processes) as executor:
        futures = {executor.submit(job.drive): job.name for job in jobs}
        for future in as_completed(futures):
            yield futures[future], future.result()


def _on_cluster(jobs: Sequence[Job], machines: Machines) -> Iterator[tuple[str, dict[str, Any]]]:
    from distributed import Client
    from distributed import as_completed as as_they_finish

    with Client(machines.scheduler) as client:
        futures = {client.submit(job.drive, pure=False): job.name for job in jobs}
        for future in as_they_finish(futures):
            yield futures[future], future.result()


def save(folder: Path, name: str, result: Mapping[str, Any]) -> None:
    """Write a result beside the others; appears whole or not at all."""
    folder.mkdir(parents=True, exist_ok=True)
    temporary = folder / f".{name}.tmp"
    temporary.write_text(json.dumps(result))
    temporary.replace(folder / f"{name}.json")


def load(folder: Path, name: str, settings: Mapping[str, Any]) -> dict[str, Any] | None:
    """A result stored before with the same settings, or None."""
    try:
        result: dict[str, Any] = json.loads((folder / f"{name}.json").read_text())
    except (OSError, ValueError):
        return None
    same: bool = result.get("settings") == json.loads(json.dumps(settings))
    return result if same else None

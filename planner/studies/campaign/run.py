"""Drives the trials of a campaign that are not stored yet: worker processes of this machine, or a dask cluster."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from hil_gateway.process.errors import InputError
from planner.studies.campaign.trial import CampaignSettings, Learnt, Trial, load, run_trial, save

Job = tuple[Trial, Learnt | None]
Outcome = tuple[Trial, dict[str, Any]]


@dataclass(frozen=True)
class Machines:
    """Where to drive: that many processes here, or the dask scheduler at an address."""

    processes: int
    scheduler: str = ""


def drive_all(jobs: Sequence[Job], settings: CampaignSettings, out: Path, machines: Machines) -> list[dict[str, Any]]:
    """All results in the order of the jobs, from the folder or driven now.

    Raises:
        InputError: a cluster is asked for and dask is missing.
    """
    if machines.scheduler and find_spec("distributed") is None:
        raise InputError("--scheduler needs dask: pip install 'hil-gateway[cluster]'")
    found = {trial: load(out, trial, settings) for trial, _ in jobs}
    missing = [job for job in jobs if found[job[0]] is None]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(file=sys.stderr)) as progress:
        task = progress.add_task("driving", total=len(jobs), completed=len(jobs) - len(missing))
        run = _on_cluster if machines.scheduler else _here
        for trial, result in run(missing, settings, machines):
            save(out, result)
            found[trial] = result
            progress.update(task, advance=1, description=f"driven {trial.name}")
    return [result for result in found.values() if result is not None]


def _here(jobs: Sequence[Job], settings: CampaignSettings, machines: Machines) -> Iterator[Outcome]:
    """Results as they finish."""
    if not jobs:
        return
    with ProcessPoolExecutor(machines.processes, mp_context=get_context("spawn")) as pool:
        futures = {pool.submit(run_trial, trial, settings, learnt): trial for trial, learnt in jobs}
        for future in as_completed(futures):
            yield futures[future], future.result()


def _on_cluster(jobs: Sequence[Job], settings: CampaignSettings, machines: Machines) -> Iterator[Outcome]:
    from distributed import Client
    from distributed import as_completed as as_they_finish

    with Client(machines.scheduler) as client:
        futures = {client.submit(run_trial, trial, settings, learnt, pure=False): trial for trial, learnt in jobs}
        for future in as_they_finish(futures):
            yield futures[future], future.result()

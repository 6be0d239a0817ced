"""`hil verify`: runs the tests of the promises and writes down what they reached."""

from __future__ import annotations

import importlib
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.commands.options import AsJson
from benchmarks.promises import mutation as mutation_run
from benchmarks.promises.promises import PROMISES, as_json, keep_long, markdown, read_evidence
from hil_gateway.process.errors import EXIT_FAILURE, InputError
from hil_gateway.process.figures import lines, print_json
from hil_gateway.process.writable import check_file
from hil_gateway.session.files.format import software_version
from hil_gateway.track.loading import load_track

app = typer.Typer(help="The reliability promises at their stated figures.")

ROOT = Path(__file__).resolve().parents[2]
HOURS_MAX = 1000.0
"""of simulated driving: weeks of computing"""
PLACES_MAX = 100
"""of a lap: days of computing"""
LONG_RUNS = ROOT / "docs" / "promises-long.json"
"""what long runs said, by promise; the usual run puts it beside its own figures"""


@app.command()
def verify(  # noqa: PLR0917 (options are passed by name)
    long: Annotated[bool, typer.Option("--long", help="the full figures; takes hours; kept in docs/")] = False,
    as_json_text: AsJson = False,
    only: Annotated[str, typer.Option("--only", help="promises to run, comma-separated: S1,L1")] = "",
    seed: Annotated[int | None, typer.Option(help="run one seed of the fault simulation")] = None,
    seeds: Annotated[int | None, typer.Option(help="run so many seeds of the fault simulation")] = None,
    healthy: Annotated[float | None, typer.Option(help="drive so many hours without a fault")] = None,
    car_faults: Annotated[int | None, typer.Option(help="every fault of the car from so many places a track")] = None,
    fault_survey: Annotated[int | None, typer.Option(help="faults of random cars and places, by this seed")] = None,
    tracks: Annotated[str, typer.Option(help="of those: names or CSV files, comma-separated; else three")] = "",
    mutation: Annotated[bool, typer.Option("--mutation", help="mutate limits, failsafe and codec")] = False,
    gathered: Annotated[Path | None, typer.Option("--from", help="only report what a test run wrote here")] = None,
    page: Annotated[Path | None, typer.Option(help="write the page of promises here: docs/promises.md")] = None,
) -> None:
    """Run the tests of the promises and say what was reached."""
    if page is not None:
        _check_page(page, whole=not (long or only or mutation) and seed is None and seeds is None)
    _check_numbers(only, seed, seeds, healthy, car_faults, gathered)
    driven = [given for given in (healthy, car_faults, fault_survey) if given is not None]
    places = _checked_tracks(tracks, wanted=bool(driven))
    if seed is not None or seeds is not None:
        report = _simulate(seed, seeds or 0)
    elif healthy is not None:
        report = _drive_healthy(healthy, places)
    elif car_faults is not None:
        report = _break_cars(car_faults, places)
    elif fault_survey is not None:
        report = _survey_faults(fault_survey, places)
    elif mutation:
        report = mutation_run.run(ROOT)
    else:
        report = _promises(long, only, gathered, page)
    if as_json_text:
        print_json(report)
    else:
        typer.echo(_plain(report))
    if not report["ok"]:
        raise typer.Exit(EXIT_FAILURE)


def _check_numbers(  # noqa: PLR0917 - the options
    only: str, seed: int | None, seeds: int | None, healthy: float | None, car_faults: int | None, gathered: Path | None
) -> None:
    if unknown := {part for part in only.split(",") if part} - {promise.id for promise in PROMISES}:
        raise InputError(f"--only {only}: no promise {', '.join(sorted(unknown))}; docs/promises.md lists them")
    if min(seed or 0, 0 if seeds is None else seeds - 1) < 0:
        raise InputError(f"--seed {seed}, --seeds {seeds}: a seed is 0 or more, and so many seeds at least 1")
    if healthy is not None and not 0.0 < healthy <= HOURS_MAX:
        raise InputError(f"--healthy {healthy:g}: hours of simulated driving, more than 0 and at most {HOURS_MAX:g}")
    if car_faults is not None and not 1 <= car_faults <= PLACES_MAX:
        raise InputError(f"--car-faults {car_faults}: places a track, at least 1 and at most {PLACES_MAX}")
    if gathered is not None and not gathered.is_file():
        raise InputError(f"{gathered}: no such file; --from takes what a test run wrote to HIL_PROMISE_FIGURES")


def _checked_tracks(tracks: str, wanted: bool) -> dict[str, Any]:
    """Keyword of a campaign: the tracks, each of which can be loaded; nothing for its own ones."""
    if tracks and not wanted:
        raise InputError(f"--tracks {tracks}: only --healthy, --car-faults and --fault-survey drive; leave it out")
    names = [name for name in tracks.split(",") if name]
    for name in names:
        load_track(name)
    return {"tracks": tuple(names)} if names else {}


def _check_page(page: Path, whole: bool) -> None:
    """Refuse, before any test has run, a page that could not be written or would leave promises out."""
    if not whole:
        raise InputError(f"--page {page}: the page is of one usual run of every promise; leave the other options out")
    check_file(page, option="--page")


def _simulate(seed: int | None, count: int) -> dict[str, Any]:
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    campaign = importlib.import_module("benchmarks.faults.campaign")  # after the thread limit is set
    if seed is None:
        report: dict[str, Any] = campaign.run_campaign(range(count))
        return {**report, "ok": not report["broken"]}
    result = campaign.Campaign().run_here(seed)
    return {**{key: getattr(result, key) for key in result.__dataclass_fields__}, "ok": not result.broken}


def _drive_healthy(hours: float, tracks: dict[str, Any]) -> dict[str, Any]:
    """Random cars without a fault, one after the other; how far each has come goes to standard error."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    campaign = importlib.import_module("benchmarks.faults.healthy")  # after the thread limit is set
    results = []
    for result in campaign.drives(3600.0 * hours, **tracks):
        results.append(result)
        effects = "".join(f", {name} {size:.3g}" for name, size in result.effects.items())
        typer.echo(
            f"{result.track}, car {result.car}{effects}: {result.seconds:.0f} s, {result.stops or 'no stop'}", err=True
        )
    report: dict[str, Any] = campaign.summary(results)
    return {**report, "ok": not report["false_stops"]}


def _break_cars(places: int, tracks: dict[str, Any]) -> dict[str, Any]:
    """Faults of sensors, actuators, power and bus; those that leave the road go to standard error as they come."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    campaign = importlib.import_module("benchmarks.faults.car_campaign")  # after the thread limit is set
    report: dict[str, Any] = campaign.run_campaign(places, **tracks)
    return report


def _survey_faults(seed: int, tracks: dict[str, Any]) -> dict[str, Any]:
    """Faults from random places of random cars; those that leave the road go to standard error as they come."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    survey = importlib.import_module("benchmarks.faults.survey")  # after the thread limit is set
    report: dict[str, Any] = survey.run_survey(seed, **tracks)
    return report


def _promises(long: bool, only: str, gathered: Path | None, page: Path | None) -> dict[str, Any]:
    """Run the marked tests (or take what a run has written) and report; `page` is a file to write it to as well."""
    started = time.time()
    with tempfile.TemporaryDirectory() as folder:
        path = gathered or Path(folder) / "figures.jsonl"
        status = 0 if gathered else _run_tests(path, long, [part for part in only.split(",") if part])
        evidence = read_evidence(path)
    when = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(started))
    took = f"{'long' if long else 'usual'} run of {time.time() - started:.0f} s"
    length = "gathered from a test run" if gathered else took
    machine = f"{os.cpu_count()} CPUs, Python {platform.python_version()}"
    conditions = f"{when}, {software_version()}, {length}, {machine}"
    if long:
        # a test may prove two promises: of one that was not asked for, the other tests are missing
        asked = {name: of for name, of in evidence.items() if not only or name in only.split(",")}
        keep_long(LONG_RUNS, asked, conditions)
    elif page is not None:
        kept = json.loads(LONG_RUNS.read_text()) if LONG_RUNS.exists() else {}
        page.parent.mkdir(parents=True, exist_ok=True)
        page.write_text(markdown(evidence, conditions, kept))
    rows = [row for row in as_json(evidence) if not only or row["id"] in only.split(",")]
    broken = [row["id"] for row in rows if row["verdict"] == "BROKEN"]
    return {"ok": status in (0, 5) and not broken, "promises": rows, "broken": broken, "conditions": conditions}


def _run_tests(path: Path, long: bool, only: list[str]) -> int:
    """pytest over the marked tests in a process of its own; its output goes to standard error."""
    environment = {**os.environ, "HIL_PROMISE_FIGURES": str(path), "HIL_PROMISES": ",".join(only)}
    if long:
        environment["HIL_LONG"] = "1"
    command = [sys.executable, "-m", "pytest", "-m", "promise", "-p", "no:cacheprovider", "--tb=short", "tests"]
    return subprocess.run(command, cwd=ROOT, env=environment, stdout=sys.stderr, check=False).returncode


def _plain(report: dict[str, Any]) -> str:
    """For people."""
    if "promises" not in report:
        return "\n".join(lines(report))
    rows = [f"{row['id']}  {row['verdict']:16s} {'; '.join(row['reached']) or '-'}" for row in report["promises"]]
    return "\n".join([*rows, report["conditions"]])

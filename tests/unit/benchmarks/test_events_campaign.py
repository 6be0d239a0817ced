"""`hil campaign laps --events`: every car drives every case and one drive without; what an event costs is said."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks.campaign.events import AFTER_S, UNDISTURBED, EventTrial, read_cases, summarise, trials
from benchmarks.campaign.run import Machines, drive_all, save
from benchmarks.commands.campaign import app
from hil_gateway.process.errors import InputError

CASES = Path(__file__).parents[3] / "benchmarks" / "cases" / "events.json"


def drive(seed: int, case: str, distance: float, **more: object) -> dict[str, object]:
    usual = {"off_track": 0, "spins": 0, "stopped": [], "worst_margin_m": 0.5}
    return {"seed": seed, "track": "oval", "case": case, "distance_m": distance, **usual, **more}


def test_every_car_drives_the_committed_cases_and_once_without() -> None:
    jobs = trials([7, 8], ("oval", "tri_oval"), read_cases(CASES))
    assert len(jobs) == 2 * (1 + len(json.loads(CASES.read_text())))
    assert jobs[0].name == f"event-007-oval-{UNDISTURBED}"
    assert {job.settings["seconds"] for job in jobs} == {106 + AFTER_S}, "all last as long: distances are compared"


def test_a_case_goes_through_its_stored_result_and_is_not_driven_again(tmp_path: Path) -> None:
    job = trials([7], ("oval",), read_cases(CASES))[3]
    stored = {"settings": dict(job.settings), "seed": 7}
    save(tmp_path, job.name, stored)
    driven = drive_all([job], tmp_path, Machines(1))[0]
    assert EventTrial(**driven["settings"]).case == "brake fade"


def test_the_summary_says_who_left_the_road_who_stopped_and_what_it_costs() -> None:
    drives = [
        drive(1, UNDISTURBED, 5000.0), drive(2, UNDISTURBED, 4000.0), drive(1, "wet", 4900.0),
        drive(2, "wet", 3000.0, off_track=2, worst_margin_m=-3.0, stopped=[[130.0, "controlled_stop", "off_road"]]),
    ]  # fmt: skip
    wet = summarise(drives)["cases"]["wet"]
    assert (wet["drives"], wet["off_track"], wet["stopped"], wet["spun"]) == (2, 1, 1, 0)
    assert (wet["worst_margin_m"], wet["most_lost_m"]) == (-3.0, 1000.0)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[", "not valid JSON"),
        ("{}", "the file holds nothing"),
        ('{"dry": []}', "dry holds nothing"),
        ('{"wet": [{"kind": "rain"}]}', "wet.0"),
        ('{"wet": [{"kind": "grip", "factor": 9}]}', "factor = 9"),
        ('{"undisturbed": [{"kind": "grip", "factor": 0.8}]}', "choose another"),
        ('{"late": [{"kind": "grip", "t": 5000, "factor": 0.8}]}', "t = 5000"),
    ],
)
def test_a_wrong_file_of_events_is_refused_with_its_place(tmp_path: Path, text: str, named: str) -> None:
    file = tmp_path / "events.json"
    file.write_text(text)
    with pytest.raises(InputError, match=named):
        read_cases(file)


def test_a_car_file_beside_events_is_refused(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["laps", "--car", "car.json", "--events", str(CASES), "--out", str(tmp_path)])
    assert isinstance(result.exception, InputError)
    assert "--car with --events" in str(result.exception)

"""`hil campaign cars`: every effect at its campaign size and mirrored, and each pair of them; a stop fails the run."""

from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks.campaign.cars import CarTrial, read_cars, summarise, trials
from benchmarks.campaign.run import save
from benchmarks.commands.campaign import app
from hil_gateway.plant.physics.effects import SWITCHES, configure
from hil_gateway.process.errors import InputError

CASES = Path(__file__).parents[3] / "benchmarks" / "cases"
SEEN = {name for name, switch in SWITCHES.items() if switch.set(configure(), switch.example) != configure()}
"""effects that the realistic car does not have already"""


def sizes(file: str) -> dict[str, dict[str, float]]:
    return {name: dict(car.effects) for name, car in read_cars(CASES / file).items()}


def test_every_effect_is_driven_at_its_campaign_size_and_mirrored() -> None:
    single = list(sizes("effects.json").values())
    assert all({name: SWITCHES[name].example} in single for name in SEEN)
    assert all({name: -switch.example} in single for name, switch in SWITCHES.items() if switch.low < 0)


def test_every_pair_of_effects_is_driven() -> None:
    pairs = {frozenset(effects) for effects in sizes("effect_pairs.json").values()}
    assert pairs >= {frozenset(pair) for pair in combinations(SEEN, 2)}


def test_cars_drive_on_all_tracks_or_are_dealt_out() -> None:
    cars = read_cars(CASES / "effects.json")
    assert len(trials(cars, ("oval", "tri_oval"), 2, deal=False)) == 2 * len(cars)
    dealt = [job.settings["track"] for job in trials(cars, ("oval", "tri_oval"), 2, deal=True)]
    assert dealt[:3] == ["oval", "tri_oval", "oval"]
    assert len(dealt) == len(cars)


def stored(out: Path, **more: object) -> None:
    job = CarTrial("late", "oval", 2, {"effects": {"drive_delay": 0.15}}).job()
    usual = {"car": "late", "track": "oval", "lap_times_s": [50.0, 49.0], "arrived": True, "stopped": []}
    drive = {**usual, "off_track": 0, "spins": 0, "worst_margin_m": 0.5, "plan_failures": 0, **more}
    save(out, job.name, {"settings": dict(job.settings), **drive})


@pytest.mark.parametrize(
    ("more", "code"),
    [
        ({}, 0),
        ({"stopped": [[35.0, "controlled_stop", "yaw_rate_wrong"]]}, 1),
        ({"off_track": 1, "worst_margin_m": -0.1}, 1),
        ({"arrived": False, "lap_times_s": [50.0]}, 1),
    ],
)
def test_a_car_that_is_stopped_leaves_the_road_or_does_not_arrive_fails(
    tmp_path: Path, more: dict[str, object], code: int
) -> None:
    file, out = tmp_path / "cars.json", tmp_path / "out"
    file.write_text(json.dumps({"late": {"effects": {"drive_delay": 0.15}}}))
    stored(out, **more)
    result = CliRunner().invoke(app, ["cars", "--cases", str(file), "--tracks", "oval", "--out", str(out)])
    assert result.exit_code == code, result.output
    counted = summarise([json.loads((out / "car-late-oval.json").read_text())])
    assert (counted["stopped"] + counted["left_the_road"] + counted["not_arrived"]) == code


def test_every_third_car_of_a_file_can_be_chosen(tmp_path: Path) -> None:
    file, out = tmp_path / "cars.json", tmp_path / "out"
    file.write_text(json.dumps({"early": {}, "late": {"effects": {"drive_delay": 0.15}}, "later": {}}))
    stored(out)
    chosen = ["--first", "1", "--every", "3"]
    result = CliRunner().invoke(app, ["cars", "--cases", str(file), "--tracks", "oval", "--out", str(out), *chosen])
    assert (result.exit_code, result.output.splitlines()[-1][:8]) == (0, "1 drives")
    with pytest.raises(InputError, match="--first 3"):
        CliRunner().invoke(app, ["cars", "--cases", str(file), "--first", "3"], catch_exceptions=False)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("{}", "holds nothing"),
        ('{"wide": {"width": 2}}', "wide.width"),
        ('{"wide": {"effects": {"width": 2}}}', "wide: effect 'width' is unknown"),
    ],
)
def test_a_wrong_file_of_cars_is_refused_with_its_place(tmp_path: Path, text: str, named: str) -> None:
    file = tmp_path / "cars.json"
    file.write_text(text)
    with pytest.raises(InputError, match=named):
        read_cars(file)

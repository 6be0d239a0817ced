"""What is proposed on recorded laps, and what is not."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import pytest
from support.drives.round_course import laps_of, write_course

from estimator.belief.revision import model_of, starting_revision
from estimator.learner.find import (
    NOTHING,
    FirstLap,
    Found,
    Task,
    find,
    judge,
    without_what_is_idle,
    without_what_spoils,
)
from estimator.learner.learnt_model import SPREAD, LapColumns, samples
from estimator.learner.rule import regress, why_not
from estimator.model.effects import catalogue
from estimator.node import HALF_WINDOW, LATE_STEER, acting_variance, late_drive
from hil_gateway.config import Config, load_config
from hil_gateway.process.errors import InputError

DRAG = 1.2
REFIT = {"vx": 0.2, "vy": 0.1, "yaw_rate": 0.02, "position": 0.2}


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Config:
    track = write_course(tmp_path_factory.mktemp("course") / "course.csv")
    return load_config(None, {"declared_model": "paper", "track": str(track)})


def task_of(config: Config, drag: float, **changes: Any) -> Task:
    start = starting_revision(config, "")
    return Task({**laps_of(drag, laps=3), **changes}, start, start, config)


@pytest.fixture(scope="module")
def with_drag(config: Config) -> tuple[Task, Found]:
    task = task_of(config, DRAG)
    return task, find(task)


def test_an_effect_that_the_declared_model_lacks_is_found_and_worth_driving_with(
    with_drag: tuple[Task, Found],
) -> None:
    _, found = with_drag
    assert found.effects == ("aero_drag",)
    assert not found.reason
    assert found.revision.effects[0].parameters["k"] == pytest.approx(DRAG, rel=0.05)
    assert all(found.errors["found"][name] < found.errors["refit"][name] for name in REFIT)
    spread = np.sqrt(np.diag(np.array(found.revision.covariance)))
    assert len(spread) == len(found.revision.tyre) + 1, "what is known of the effect goes on with it"
    assert abs(found.revision.effects[0].parameters["k"] - DRAG) < 3 * spread[-1]


def test_the_first_lap_tells_a_better_model_from_a_worse_one(with_drag: tuple[Task, Found]) -> None:
    task, found = with_drag
    adopted = Task(task.columns, task.declared, found.revision, task.config)
    assert not regress(*judge(FirstLap(adopted, 2, before=task.declared)), 30.0, 30.0)
    assert "worse" in regress(*judge(FirstLap(task, 2, before=found.revision)), 30.0, 30.0)


@pytest.mark.parametrize("declared_model", ["paper", "race_car"])
def test_what_is_proposed_was_taught_by_inputs_as_uncertain_as_while_driving(
    config: Config, declared_model: str
) -> None:
    columns = laps_of(DRAG, laps=3)
    declared = starting_revision(config.model_copy(update={"declared_model": declared_model}), "")
    revised, count = model_of(declared, config.vehicle, 1000.0), len(columns["t"])
    columns |= {name: np.zeros(count) for name in SPREAD}
    taught = list(samples(LapColumns(columns, np.zeros(count)), revised))[:500]
    for which, (name, late) in enumerate({"steer": LATE_STEER, "drive": late_drive(revised.model)}.items()):
        window: deque[float] = deque(maxlen=HALF_WINDOW + late)
        while_driving = []
        for value in columns[name][: HALF_WINDOW + len(taught) + HALF_WINDOW]:
            window.append(value)
            while_driving.append(acting_variance(window))
        found = [s.input_variance[which] for s in taught]
        assert found[late:] == pytest.approx(while_driving[2 * HALF_WINDOW + late : 2 * HALF_WINDOW + len(taught)])
        assert max(found) > 0.0


def test_nothing_is_proposed_where_nothing_is_missing(config: Config) -> None:
    found = find(task_of(config, 0.0))
    assert found.effects == ()
    assert found.reason == NOTHING


def test_a_lap_without_estimates_is_said_to_be_too_little(config: Config) -> None:
    task = task_of(config, 0.0)
    keep = (task.columns["lap"] < 2) | (np.arange(len(task.columns["t"])) % 400 == 0)
    with pytest.raises(InputError, match="held-out lap"):
        find(Task({n: c[keep] for n, c in task.columns.items()}, task.declared, task.current, config))


@pytest.mark.parametrize(
    ("spoiling", "kept"),
    [("", "wind drag brake"), ("drag", "wind brake"), ("drag brake", "wind"), ("wind drag brake", "")],
)
def test_an_effect_that_spoils_predictions_does_not_take_the_others_with_it(
    config: Config, spoiling: str, kept: str
) -> None:
    start = starting_revision(config, "")

    def outcome(effects: tuple[str, ...]) -> Found:
        """Each good effect takes a tenth off every error, each that spoils adds a half to that of vx."""
        bad = len(set(effects) & set(spoiling.split()))
        errors = {name: value * 0.9 ** (len(effects) - bad) for name, value in REFIT.items()}
        errors["vx"] *= 1.5**bad
        return Found(effects, start, why_not(REFIT, REFIT, errors), {"refit": REFIT, "found": errors})

    whole = outcome(("wind", "drag", "brake"))
    left = without_what_spoils(whole, outcome)
    assert left.effects == (tuple(kept.split()) or whole.effects)
    assert bool(left.reason) == (not kept)


@pytest.mark.parametrize(
    ("worth", "kept"),
    [({"wind": 0.9, "drag": 0.9}, "wind drag"), ({"wind": 0.8, "drag": 0.995}, "wind"), ({"wind": 0.8}, "wind")],
)
def test_an_effect_without_which_predictions_are_as_good_is_left_out(
    config: Config, worth: dict[str, float], kept: str
) -> None:
    start = starting_revision(config, "")

    def outcome(effects: tuple[str, ...]) -> Found:
        """Each effect takes its part off every error."""
        errors = {name: value * np.prod([worth.get(e, 1.0) for e in effects]) for name, value in REFIT.items()}
        return Found(effects, start, why_not(REFIT, REFIT, errors), {"refit": REFIT, "found": errors})

    assert without_what_is_idle(outcome(("wind", "drag")), outcome).effects == tuple(kept.split())


@pytest.mark.parametrize(
    ("name", "moves"),
    [("imu_lever_arm", False), ("imu_misalignment", False), ("engine_braking", True), ("steer_scale", True)],
)
def test_the_mounting_of_an_accelerometer_is_nothing_to_drive_with(name: str, moves: bool) -> None:
    assert catalogue()[name].moves_the_car is moves


@pytest.mark.parametrize(
    ("found", "words"),
    [
        ({}, "not worth a change"),
        ({"vx": 0.1}, ""),
        ({"vx": 0.1, "yaw_rate": 0.021}, "prediction of yaw_rate is 1.05 times worse than that of the re-fitted"),
        ({"vx": 0.1, "vy": 0.0999, "position": 0.15}, "worse than that of the model in force"),
        ({"vx": float("nan")}, "diverges"),
    ],
)
def test_a_model_is_proposed_only_where_no_channel_gets_worse_and_all_together_better(
    found: dict[str, float], words: str
) -> None:
    in_force = {**REFIT, "position": 0.14} if "position" in found else REFIT
    reason = why_not(REFIT, in_force, {**REFIT, **found})
    assert words in reason
    assert bool(reason) == bool(words)


@pytest.mark.parametrize(
    ("after", "lap_s", "words"),
    [(REFIT, 80.0, ""), ({**REFIT, "vy": 0.12}, 80.0, "vy is 1.20 times worse"), (REFIT, 82.0, "took 82.0 s")],
)
def test_a_model_stays_only_where_the_first_lap_is_no_worse_and_no_slower(
    after: dict[str, float], lap_s: float, words: str
) -> None:
    reason = regress(REFIT, after, 80.0, lap_s)
    assert words in reason
    assert bool(reason) == bool(words)

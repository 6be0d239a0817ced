"""Learning campaign: what is counted, paired, scored and reported; trials are repeatable and resumable."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.campaign import trial as campaign
from benchmarks.campaign.after import compare, learnt_by
from benchmarks.campaign.analysis import (
    bootstrap,
    d_target,
    drives_of,
    lap_time_lost_percent,
    seconds_to,
    summarise,
)
from benchmarks.campaign.driving import EXCITATION_ACCELERATION, ExcitedBus, RecordingEstimator
from benchmarks.campaign.report import write_report
from benchmarks.campaign.run import load, save
from benchmarks.campaign.safety import load_shares, slip_shares
from benchmarks.campaign.trial import (
    KNOWN,
    CampaignSettings,
    Learnt,
    Trial,
    starting_knowledge,
    trial_config,
    true_tyre,
)
from benchmarks.commands.campaign import _methods
from estimator.belief.tyre_belief import Sample
from estimator.model.measurement import measurement_function
from estimator.model.parameters import tyre_parameters, tyre_prior
from estimator.model.single_track import AUXILIARY, SingleTrack
from hil_gateway.bus import topics
from hil_gateway.bus.interface import LocalBus
from hil_gateway.bus.messages import Command, Estimate
from hil_gateway.car.car import load_car
from hil_gateway.process.errors import InputError

SETTINGS = CampaignSettings()
NAMES = [p.name for p in tyre_parameters(tyre_prior(load_car(), "per_axle"))]


def made_up(method: str, seed: int, rate: float) -> dict[str, Any]:
    """Result of a drive whose information grows `rate` times as fast as plain driving's and whose mean converges."""
    rng = np.random.default_rng(seed)
    tyre = true_tyre(seed, SETTINGS)
    truth = np.array([tyre.get(n, tyre_prior(load_car(), "per_axle")["cx"]) for n in NAMES])
    prior = np.array([tyre_prior(load_car(), "per_axle")[n] for n in NAMES])
    t = np.arange(0.0, 100.0, 0.1)
    mean = truth + (prior - truth) * np.exp(-rate * t / 8.0)[:, None]
    signals = np.column_stack([rng.uniform(20, 50, 300), rng.normal(0, 1, 300), rng.normal(0, 0.3, 300),
                               rng.normal(0, 0.05, 300), np.zeros(300)])  # fmt: skip
    h = measurement_function(
        SingleTrack(load_car().vehicle, tyre_prior(load_car(), "per_axle")),
        "imu_yaw",
    )
    z = np.array(h(signals.T, np.zeros((len(AUXILIARY), 1)), truth, np.zeros((0, 1)))[0]).T
    return {
        "trial": {"method": method, "seed": seed}, "settings": {}, "truth": tyre, "start_s": 2.0,
        "lap_times_s": [98.0 if method == "plain" else 99.0],
        "progress": {"t": t.tolist(), "s": (t * (36.0 if method == "plain" else 35.5)).tolist()},
        "safety": {"laps": 1, "off_track": 0, "worst_margin_m": 0.4, "load_violations": 0, "load_by_model": 0,
                   "worst_load_share": 0.98, "worst_true_load_share": 1.01, "traction_lost": 0, "worst_slip_share": 0.7,
                   "plan_failures": 0, "failsafes": []},
        "belief": {"t": (t + 2.0).tolist(), "log_det": (7 * np.log1p(rate * t)).tolist(), "names": NAMES,
                   "mean": mean.tolist()},
        "held_out": {"signals": signals.tolist(), "z": (z + rng.normal(0, 0.1, z.shape)).tolist()}
        if method == KNOWN else None,
        "learnt": {"tyre": dict(zip(NAMES, truth.tolist(), strict=True)), "covariance": np.eye(7).tolist(),
                   "limits": [1.2, 1.3]},
    }  # fmt: skip


@pytest.fixture(scope="module")
def summary_and_drives() -> tuple[dict[str, Any], list[Any]]:
    results = [made_up(m, s, r) for s in range(6) for m, r in (("infomax", 3.0), ("plain", 1.0), (KNOWN, 1.0))]
    drives = drives_of(results)
    return {**summarise(drives, 3500.0), "afterwards": None}, drives


def test_learning_three_times_as_fast_is_counted_as_a_third_of_the_samples(
    summary_and_drives: tuple[dict[str, Any], list[Any]],
) -> None:
    infomax = summary_and_drives[0]["methods"]["infomax"]
    for target in ("d_10_percent", "d_5_percent", "rmse", "learnt"):
        assert infomax["targets"][target]["fewer_than_plain"]["median"] == pytest.approx(3.0, rel=0.12), target
        assert infomax["targets"][target]["reached"] == 6
    assert infomax["lap_time_lost_percent"]["median"] == pytest.approx(100 * (36.0 / 35.5 - 1.0), abs=1e-3)
    assert summary_and_drives[0]["methods"]["plain"]["targets"]["rmse"]["fewer_than_plain"]["median"] == 1.0


def test_time_lost_in_part_of_a_lap_is_a_share_of_that_lap(
    summary_and_drives: tuple[dict[str, Any], list[Any]],
) -> None:
    slow, fast = (next(d for d in summary_and_drives[1] if d.method == m) for m in ("infomax", "plain"))
    per_lap = lap_time_lost_percent(slow, fast, 3600.0)
    assert per_lap == pytest.approx(100 * (36.0 / 35.5 - 1.0) * fast.progress[1][-1] / 3600.0, rel=0.02)
    assert lap_time_lost_percent(slow, fast, 1000.0) == pytest.approx(100 * (36.0 / 35.5 - 1.0), rel=1e-3)


def test_report_is_one_page_without_references_to_elsewhere(
    summary_and_drives: tuple[dict[str, Any], list[Any]], tmp_path: Path
) -> None:
    summary, drives = summary_and_drives
    text = write_report(drives, summary, tmp_path / "report.html").read_text()
    assert "infomax MPCC" in text
    assert "<svg" in text or "data:image/png" in text
    assert "<script src" not in text
    assert "<link" not in text


def test_a_target_never_reached_counts_in_full_and_says_so() -> None:
    t = np.arange(5.0)
    assert seconds_to(t, np.array([0, 1, 2, 3, 4.0]), 3.0, rising=True) == (3.0, True)
    assert seconds_to(t, np.array([0, 1, 2, 1, 0.0]), 3.0, rising=True) == (4.0, False)
    assert seconds_to(t, np.array([5, 1, 5, 1, 1.0]), 2.0, rising=False) == (3.0, True), "must stay there"


def test_bootstrap_interval_holds_the_median_and_narrows_with_seeds() -> None:
    rng = np.random.default_rng(1)
    few, many = (bootstrap(rng.normal(2.0, 1.0, n).tolist()) for n in (10, 400))
    assert few.low <= few.median <= few.high
    assert many.high - many.low < 0.5 * (few.high - few.low)


def test_d_target_is_the_log_det_of_that_accuracy() -> None:
    table = tyre_parameters(tyre_prior(load_car(), "per_axle"))
    covariance = np.diag([(0.05 * p.prior) ** 2 for p in table])
    scale = np.array([p.prior_std for p in table])
    assert d_target(0.05) == pytest.approx(-np.linalg.slogdet(covariance / np.outer(scale, scale))[1])


def test_every_method_meets_the_same_car_with_its_own_noise() -> None:
    configs = [trial_config(Trial(method, 3), SETTINGS) for method in campaign.METHODS]
    assert all(c.plant.car == configs[0].plant.car for c in configs)
    assert len({c.plant.seed for c in configs}) == len(configs)
    assert [c.planner.information_weight > 0 for c in configs] == [True, False, False, False]
    assert trial_config(Trial("plain", 4), SETTINGS).plant.car != configs[0].plant.car


def test_finished_trials_are_not_driven_again_unless_the_settings_changed(tmp_path: Path) -> None:

    trial = Trial("plain", 0)
    result = {"trial": asdict(trial), "settings": asdict(SETTINGS)}
    assert load(tmp_path, trial.name, asdict(SETTINGS)) is None
    save(tmp_path, Trial(**result["trial"]).name, result)
    assert load(tmp_path, trial.name, asdict(SETTINGS)) is not None
    assert load(tmp_path, trial.name, asdict(replace(SETTINGS, laps=7))) is None
    (tmp_path / f"{trial.name}.json").write_text("{broken")
    assert load(tmp_path, trial.name, asdict(SETTINGS)) is None


@pytest.mark.parametrize("method", ["prbs", "sine"])
def test_excitation_adds_a_bounded_signal_only_at_speed(method: str) -> None:
    inner = LocalBus()
    bus, out = ExcitedBus(inner, method, 1), inner.subscribe(topics.COMMAND, depth=2000)
    for k in range(1000):
        now_ns = k * 50_000_000
        speed = 5.0 if k < 200 else 40.0
        zero = dict.fromkeys(("x", "y", "yaw", "vy", "yaw_rate", "bias_ax", "bias_ay", "bias_yaw_rate"), 0.0)
        inner.publish(topics.ESTIMATE, Estimate(
            stamp_ns=now_ns, seq=k, state_stamp_ns=now_ns, valid=True, vx=speed, **zero, std=(0.0,) * 9, steer=0.0,
            drive=0.0, innovations_rejected=0,
        ))  # fmt: skip
        command = Command(stamp_ns=now_ns, seq=k, source="planner", state_stamp_ns=now_ns, steer=0.01, drive=0.0)
        bus.publish(topics.COMMAND, command)
    added = np.array([c.steer - 0.01 for c in out.poll(0)])
    amplitude = EXCITATION_ACCELERATION * 3.0 / 40.0**2
    assert np.all(added[:200] == 0.0)
    assert np.max(np.abs(added)) == pytest.approx(amplitude, rel=0.01)
    assert abs(np.mean(added[200:])) < 0.25 * amplitude


def test_load_share_is_that_of_the_true_tyres() -> None:
    tyre = {"bf": 9.0, "cf": 1.4, "df": 1.5, "br": 10.0, "cr": 1.4, "dr": 1.5}
    peak = np.tan(np.pi / 2 / 1.4) / 9.0
    signals = np.array([40.0, 0.0, 0.0, peak, 0.0])
    kept = [sample_of(s) for s in (signals, np.array([5.0, *signals[1:]]))]
    assert load_shares(kept, tyre, (1.2, 1.3)) == pytest.approx([1.5 / 1.2, 0.0])
    assert slip_shares(kept, tyre) == pytest.approx([1.0, 0.0])


def sample_of(signals: np.ndarray) -> Sample:
    return Sample(signals, np.zeros((3, 3)), np.array([0.0, 12.0, 0.0]), np.zeros(len(AUXILIARY)))


def test_beliefs_are_judged_by_a_drive_that_is_not_among_the_ways_of_driving(
    summary_and_drives: tuple[dict[str, Any], list[Any]],
) -> None:
    assert {d.method for d in summary_and_drives[1]} == {"infomax", "plain"}
    car = true_tyre(3, SETTINGS)
    known, prior = (starting_knowledge(Trial(method, 3), SETTINGS) for method in (KNOWN, "prior"))
    assert {name: known.tyre[name] for name in car} == car
    assert prior.tyre == tyre_prior(load_car(), "per_axle")
    assert prior.limits == (0.0, 0.0), "no load counts as borne before the drive"
    spread = np.sqrt(np.diag(prior.covariance)) / list(prior.tyre.values())
    assert spread == pytest.approx(np.full(7, SETTINGS.mismatch)), "declared tyres are as doubtful as cars are off"


def test_without_learning_samples_are_kept_and_teach_nothing() -> None:
    config = trial_config(Trial("plain", 0), SETTINGS)
    sample = sample_of(np.array([40.0, -1.0, 0.3, 0.08, 0.0]))
    off = config.model_copy(update={"estimator": config.estimator.model_copy(update={"learn": False})})
    learning, fixed = (RecordingEstimator(of, LocalBus()) for of in (config, off))
    for k in range(2000):
        for estimator in (learning, fixed):
            estimator.learn(sample, k * 10_000_000)
    assert learning.belief.samples == 2000
    assert fixed.belief.samples == 0
    assert np.array_equal(fixed.belief.covariance, RecordingEstimator(off, LocalBus()).belief.covariance)
    assert len(learning.kept) == len(fixed.kept) == 400


def test_cars_are_off_by_the_mismatch_up_or_down() -> None:
    ratios = np.array([
        [value / tyre_prior(load_car(), "per_axle")[name] for name, value in true_tyre(seed, SETTINGS).items()]
        for seed in range(20)
    ])  # fmt: skip
    assert np.abs(ratios - 1.0) == pytest.approx(np.full(ratios.shape, SETTINGS.mismatch))
    assert np.all((ratios < 1.0).any(axis=0) & (ratios > 1.0).any(axis=0)), "both signs of every parameter"


def test_learning_is_proved_by_the_laps_after_it(
    summary_and_drives: tuple[dict[str, Any], list[Any]], tmp_path: Path
) -> None:
    results = []
    for seed, (before, after) in enumerate([(100.0, 95.0), (102.0, 97.0), (101.0, 102.0)]):
        for method, lap in (("prior", before), ("learnt", after)):
            results.append({**made_up(method, seed, 1.0), "lap_times_s": [lap]})
    found = compare(results)
    assert found is not None
    assert found["faster_percent"]["median"] == pytest.approx(100 * 5 / 102)
    assert found["slower_cars"] == 1
    assert compare(results[:1]) is None
    results[0]["safety"] = {**results[0]["safety"], "off_track": 1}
    without = compare(results)
    assert without is not None
    assert without["seeds"] == 2
    assert without["left_the_track"] == {"prior": [0], "learnt": []}
    assert set(without["cars"]) == {0, 1, 2}, "every car is named, compared or not"
    summary, drives = summary_and_drives
    assert "After learning" in write_report(drives, {**summary, "afterwards": found}, tmp_path / "r.html").read_text()


def test_what_was_learnt_survives_the_file(tmp_path: Path) -> None:
    result = {**made_up("infomax", 0, 1.0), "settings": {}}
    save(tmp_path, Trial(**result["trial"]).name, result)
    learnt = learnt_by(json.loads((tmp_path / "infomax-000.json").read_text()))
    assert isinstance(learnt, Learnt)
    assert learnt.limits == (1.2, 1.3)
    assert learnt.tyre == result["learnt"]["tyre"]


def test_unknown_method_is_named_and_plain_is_always_driven() -> None:
    assert _methods("infomax") == ("infomax", "plain")
    with pytest.raises(InputError, match="magic"):
        _methods("infomax,magic")

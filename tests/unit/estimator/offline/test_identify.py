"""`hil identify` from files to JSON and report, and on measured data where that is there."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.drives.drive_simulator import TYRE, simulate, to_csv
from typer.testing import CliRunner

from estimator.cli.identify import app
from estimator.drive_log.table import DriveLog, read_logs
from estimator.model.parameters import tyre_prior
from estimator.model.tyre import AXLES, normalised_force
from estimator.offline.identification import Identification, Options, identify, score_log
from estimator.offline.record.declared import read_tyre_prior, read_vehicle
from estimator.offline.report.plots import curve_band
from estimator.offline.tyre_export import exported, not_exported
from hil_gateway.car.car import load_car
from hil_gateway.process.errors import InputError


@pytest.fixture(scope="module")
def log_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "drive.csv"
    path.write_text(to_csv(simulate([TYRE], 50.0, seed=31)[0].columns))
    return path


def test_json_and_report_hold_what_the_format_promises(log_file: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, [str(log_file), "--json", "--method", "batch", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    promised = {"layout", "method", "initial", "final", "std", "identifiable", "rmse", "curve", "seconds"}
    assert promised <= set(summary)
    assert summary["rmse"]["ay"]["final"] < summary["rmse"]["ay"]["initial"]
    assert set(summary["final"]) == set(TYRE)
    assert json.loads((tmp_path / "tyre.json").read_text()) == summary["exported"]
    page = (tmp_path / "report.html").read_text()
    assert page.count("<figure>") >= 4
    for source in ('src="http', "url(http", "<script src", '<link rel="stylesheet"'):
        assert source not in page


@pytest.fixture(scope="module")
def identified() -> Identification:
    """An identification of a minute's drive."""
    columns = simulate([TYRE], 60.0, seed=33)[0].columns
    log = DriveLog(dict(columns), np.zeros(len(columns["t"]), np.int64))
    return identify(log, load_car().vehicle, TYRE, Options(method="batch"))


def test_what_the_data_does_not_determine_stays_at_the_prior_in_the_export(identified: Identification) -> None:
    known = identified.identifiability
    doubtful = replace(known, identifiable=dict.fromkeys(known.identifiable, False))
    values = exported(
        replace(identified, identifiability=replace(doubtful, stiffness_std={"front": 0.05, "rear": 1.0}))
    )
    final, prior = identified.final, identified.initial
    assert values["cx"] == prior["cx"]
    assert (values["cf"], values["df"]) == (prior["cf"], prior["df"])
    assert values["bf"] * values["cf"] * values["df"] == pytest.approx(final["bf"] * final["cf"] * final["df"])
    assert [values[n] for n in ("br", "cr", "dr")] == [prior[n] for n in ("br", "cr", "dr")]


def test_a_curve_no_tyre_has_is_not_exported(identified: Identification) -> None:
    known = replace(identified.identifiability, identifiable=dict.fromkeys(identified.initial, True))
    peak_at_one_degree = identified.fit.values | {"bf": 50.0, "cf": 1.8, "df": 0.6}
    strange = replace(identified.fit, theta=np.array([peak_at_one_degree[n] for n in identified.fit.names]))
    values = exported(replace(identified, identifiability=known, fit=strange))
    assert values["cf"] == identified.initial["cf"]
    assert values["cr"] == identified.final["cr"]


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_a_stiffness_no_tyre_has_is_not_exported_and_said(identified: Identification, factor: float) -> None:
    known = replace(identified.identifiability, identifiable=dict.fromkeys(identified.initial, True))
    values = {**identified.fit.values, "bf": factor * identified.fit.values["bf"]}
    strange = replace(identified.fit, theta=np.array([values[n] for n in identified.fit.names]))
    result = replace(identified, identifiability=known, fit=strange)
    assert exported(result)["bf"] == identified.initial["bf"]
    assert [line.split(":")[0] for line in not_exported(result)] == ["front"]


def test_band_of_the_tyre_curve_holds_the_curve_and_covers_draws_of_the_fit(identified: Identification) -> None:
    fit, axle = identified.fit, AXLES["per_axle"][0]
    rows, slips = list(axle.rows(fit.names)), np.linspace(-0.06, 0.06, 25)
    covariance = 0.01**2 * np.diag(fit.theta**2)
    low, high = curve_band(replace(fit, covariance=covariance), axle, slips)
    curve = normalised_force(slips, *fit.theta[rows])
    assert np.all((low <= curve) & (curve <= high))
    draws = np.random.default_rng(1).multivariate_normal(fit.theta[rows], covariance[np.ix_(rows, rows)], 4000)
    inside = [(low <= f) & (f <= high) for f in (normalised_force(slips, *d) for d in draws)]
    covered = np.mean(inside, axis=0)[slips != 0.0]
    assert np.all((covered > 0.93) & (covered < 0.97)), covered


def test_shared_layout_takes_a_prior_per_axle(log_file: Path, tmp_path: Path) -> None:
    prior = tmp_path / "tyre.json"
    prior.write_text(json.dumps(TYRE))
    arguments = [str(log_file), "--json", "--method", "batch", "--layout", "shared", "--tyre", str(prior)]
    summary = json.loads(CliRunner().invoke(app, arguments).stdout)
    assert set(summary["final"]) == {"cx", "b", "c", "d"}
    assert summary["initial"]["b"] == pytest.approx(0.5 * (TYRE["bf"] + TYRE["br"]))


def test_one_tyre_for_both_axles_is_fitted_to_measured_accelerations(log_file: Path) -> None:
    """Simulated, the balance that it fixes would bend the tyre."""
    done = identify(
        read_logs([log_file]), load_car().vehicle, tyre_prior(load_car(), "shared"), Options(layout="shared")
    )
    assert done.formulation == "algebraic"
    assert done.rmse["ay"][1] < 0.25 * done.rmse["ay"][0]


def test_a_log_too_short_to_hold_anything_out_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "short.csv"
    path.write_text(to_csv(simulate([TYRE], 15.0, seed=32)[0].columns))
    with pytest.raises(InputError, match="s of driving in the log: a car of this size needs 20 s"):
        identify(read_logs([path]), load_car().vehicle, tyre_prior(load_car(), "per_axle"), Options(method="batch"))


def test_the_clock_of_a_log_changes_nothing(log_file: Path) -> None:
    """Seconds of the day, of a bag or of Unix are the same drive: the same rows are held out."""
    log, options = read_logs([log_file]), Options(method="batch")
    later = replace(log, columns={**log.columns, "t": log["t"] + 86_390.0})
    one, other = (identify(each, load_car().vehicle, TYRE, options) for each in (log, later))
    assert np.array_equal(one.split.test, other.split.test)
    assert other.final == pytest.approx(one.final, rel=1e-6)


def test_a_lap_column_that_leaves_nothing_to_fit_is_refused_in_one_line(tmp_path: Path) -> None:
    """Laps of a second are all within the guard time of one that is held out."""
    columns = simulate([TYRE], 26.0, seed=32)[0].columns
    path = tmp_path / "laps.csv"
    path.write_text(to_csv({**columns, "lap": np.floor(columns["t"])}))
    with pytest.raises(InputError, match=r"left to fit with .* whole laps held out: .*column lap"):
        identify(read_logs([path]), load_car().vehicle, tyre_prior(load_car(), "per_axle"), Options(method="batch"))


def test_a_log_shorter_than_four_blocks_still_holds_a_quarter_out(tmp_path: Path) -> None:
    path = tmp_path / "short.csv"
    path.write_text(to_csv(simulate([TYRE], 26.0, seed=32)[0].columns))
    done = identify(read_logs([path]), load_car().vehicle, tyre_prior(load_car(), "per_axle"), Options(method="batch"))
    assert 0.15 < done.split.test.mean() < 0.35
    assert done.split.train.mean() > 0.5


def test_result_is_scored_on_another_log(log_file: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.csv"
    columns = simulate([TYRE], 25.0, seed=32)[0].columns
    other.write_text(to_csv(columns))
    arguments = [str(log_file), "--json", "--method", "batch", "--score", str(other)]
    scored = json.loads(CliRunner().invoke(app, arguments).stdout)["scored"][str(other)]
    assert scored["ay"]["final"] < 0.2 < scored["ay"]["initial"]


def test_errors_of_another_log_are_told_simulated_and_at_measured_states(log_file: Path, tmp_path: Path) -> None:
    arguments = [str(log_file), "--score", str(log_file), "--out", str(tmp_path)]
    text = CliRunner().invoke(app, arguments).stdout
    summary = json.loads((tmp_path / "identification.json").read_text())
    for rmse, at_states in (
        (summary["rmse"], summary["rmse_at_states"]),
        (summary["scored"][str(log_file)], summary["scored_at_states"][str(log_file)]),
    ):
        assert rmse["ay"]["final"] != at_states["ay"]["final"]
    assert "held-out RMSE ay" in text
    assert "drive.csv, at measured states, RMSE ay" in text
    page = (tmp_path / "report.html").read_text()
    assert "Scored on other logs" in page
    assert "<th>Unit</th>" in page, "of what is estimated along with the tyres"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "not valid JSON"),
        ('{"mass": 800, "yaw_inertia": 1000, "lf": 1.7}', "lr is missing"),
        ('{"mass": true, "yaw_inertia": 1000, "lf": 1.7, "lr": 1.2}', "mass = True"),
        ('{"mass": 800, "yaw_inertia": 1, "lf": 1.7, "lr": 1.2}', "radius of gyration is 0.012 wheelbases"),
        ('{"mass": -1, "yaw_inertia": 1000, "lf": 1.7, "lr": 1.2}', "mass = -1"),
        ('{"mass": 800, "yaw_inertia": 1000, "lf": 1.7, "lr": 1.2, "wings": 2}', "wings"),
    ],
)
def test_broken_vehicle_file_is_refused_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "vehicle.json"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_vehicle(path, load_car())


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"cx": 1}', "bf is missing"),
        ('{"b": 1, "q": 2}', "unknown key q"),
        ('{"cx": 5e4, "b": 1e300, "c": 1.4, "d": 1.4}', r"b = 1e\+300: a tyre has 0 to 80"),
        ('{"cx": 5e4, "b": 10, "c": 1.4, "d": 1.4, "d": 1.5}', "key 'd' is there twice"),
    ],
)
def test_broken_tyre_prior_is_refused_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "tyre.json"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        read_tyre_prior(path, "per_axle", read_vehicle(None, load_car()), load_car())


def _identify(path: Path, vehicle: Path | None, tyre: Path | None, **options: object) -> Identification:
    chosen = Options(**options)  # type: ignore[arg-type]
    car = read_vehicle(vehicle, load_car())
    return identify(read_logs([path]), car, read_tyre_prior(tyre, chosen.layout, car, load_car()), chosen)


@pytest.mark.slow
def test_practice_log_is_identified_to_a_percent(measured_data: Path) -> None:
    folder = measured_data / "practice"
    result = _identify(folder / "p01.csv", folder / "vehicle.json", folder / "tyre.json")
    truth = json.loads((folder / "p01.truth.json").read_text())["tyre"]
    limits = {"cx": 0.01, "df": 0.03, "dr": 0.03}
    for name, value in truth.items():
        assert result.final[name] == pytest.approx(value, rel=limits.get(name, 0.06))
        assert abs(result.final[name] - value) < 2.576 * result.fit.std[name], name
    for axle in "fr":
        found, right = (v[f"b{axle}"] * v[f"c{axle}"] * v[f"d{axle}"] for v in (result.final, truth))
        assert found == pytest.approx(right, rel=0.02)
    assert result.rmse["ay"][1] < 1.05 * 0.15


@pytest.mark.slow
def test_measured_run_is_repaired_and_predicted(measured_data: Path) -> None:
    result = _identify(measured_data / "av21" / "putnam_run4_2.csv", None, None)
    found = {f.name: f for f in result.health.findings}
    assert 0.28 <= found["offset_yaw_rate"].size <= 0.36
    assert found["useless_ax_logged"].size > 1.0
    assert "offset_vy" in found
    assert result.rmse["ay"][1] <= 0.14
    assert result.rmse["yaw_rate"][1] <= 0.0060
    assert result.rmse["ax"][1] <= 0.77
    assert "D, C and B of the front axle cannot be separated" in " ".join(result.identifiability.statements)


@pytest.mark.slow
@pytest.mark.long
def test_model_car_is_predicted_better_with_steering_lag_and_separate_axles(measured_data: Path) -> None:
    folder = measured_data / "dart"
    train, *others = (
        next(folder.glob(name)) for name in ("free*02_28.csv", "free*01_01.csv", "*fast*.csv", "*rub*.csv")
    )
    car = load_car().vehicle.model_copy(update={"mass": 1.58, "yaw_inertia": 0.0048, "lf": 0.0805, "lr": 0.0930})

    def run(**options: Any) -> Identification:
        prior = read_tyre_prior(None, options.get("layout", "per_axle"), car, load_car())
        return identify(read_logs([train]), car, prior, Options(**options))

    plain = run(layout="shared", method="batch", keep=frozenset({"lag_steer", "offset_steer"}))
    whole = run()
    found = {f.name: f.size for f in whole.health.findings}
    assert 0.03 < found["lag_steer"] < 0.07
    assert np.degrees(found["offset_steer"]) == pytest.approx(-0.6, abs=0.3)
    assert not whole.identifiability.identifiable["br"]
    assert "cr = 0.5 ended on its bound: it is not exported" in whole.identifiability.statements
    assert whole.fit.std["br"] > 0.2 * whole.fit.values["br"]
    ratios = [score_log(whole, log).rmse["ay"][1] / score_log(plain, log).rmse["ay"][1] for log in map(_read, others)]
    assert float(np.mean(ratios)) < 0.75
    assert all(np.isfinite(list(whole.fit.std.values())))


def _read(path: Path) -> DriveLog:
    return read_logs([path])

"""Cars of any size, and every measured run at hand: results or one clear line, never a traceback."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support.drives.any_car import AnyCar
from support.drives.similar_car import SimilarCar
from support.promise_figures import volume

from estimator.drive_log.table import DriveLog, read_logs
from estimator.offline.diagnosis import diagnose
from estimator.offline.identification import Options, identify
from estimator.offline.record.declared import default_tyre_prior, read_vehicle
from estimator.offline.record.record import make_record
from estimator.offline.report.diagnosis_result import as_revision
from hil_gateway.car.car import load_car
from hil_gateway.process.errors import InputError

MODEL_CAR = {"mass": 1.58, "yaw_inertia": 0.0048, "lf": 0.0805, "lr": 0.0930}
"""1:10, of the measured runs"""
CARS = {
    "1:10": AnyCar(2.0, 0.2, rear=(9.0, 1.5, 1.2)),
    "kart": AnyCar(160.0, 1.05, front=(8.0, 1.45, 1.3)),
    "lorry": AnyCar(3000.0, 4.0, front_share=0.5, front=(9.0, 1.4, 0.8), rear=(10.0, 1.4, 0.8)),
}


@cache
def _log(car: AnyCar) -> DriveLog:
    columns = car.drive(seed=1)
    return DriveLog(columns, np.zeros(len(columns["t"]), np.int64))


def _vehicle_file(folder: Path, values: dict[str, float]) -> Path:
    path = folder / "vehicle.json"
    path.write_text(json.dumps(values))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("name", ["1:10", *(pytest.param(name, marks=pytest.mark.long) for name in ("kart", "lorry"))])
def test_tyres_of_a_car_of_any_size_are_found(name: str, tmp_path: Path) -> None:
    car = CARS[name]
    vehicle = read_vehicle(_vehicle_file(tmp_path, car.vehicle), load_car())
    found = identify(_log(car), vehicle, default_tyre_prior("per_axle", vehicle, load_car()), Options()).final
    stiffness = [np.prod([found[f"{p}{axle}"] for p in "bcd"]) for axle in "fr"]
    np.testing.assert_allclose(stiffness, [np.prod(car.front), np.prod(car.rear)], rtol=0.05)
    assert found["cx"] == pytest.approx(car.slip_stiffness * car.mass * 9.80665, rel=0.05)


def _found_of_the_plants(car: SimilarCar, folder: Path) -> list[float]:
    """Stiffness of front and rear axle and along, over those of the car; a sound log has nothing found wrong."""
    vehicle, columns = read_vehicle(_vehicle_file(folder, car.vehicle), load_car()), car.log()
    log = DriveLog(columns, np.zeros(len(columns["t"]), np.int64))
    result = identify(log, vehicle, default_tyre_prior("per_axle", vehicle, load_car()), Options())
    assert not result.health.findings
    across = [np.prod([result.final[f"{p}{axle}"] for p in "bcd"]) for axle in "fr"]
    return [found / true for found, true in zip((*across, result.final["cx"]), car.stiffness, strict=True)]


@pytest.mark.slow
def test_what_is_found_of_a_four_wheel_car_does_not_depend_on_its_size(tmp_path: Path) -> None:
    small, large = (_found_of_the_plants(SimilarCar(5, *size), tmp_path) for size in ((0.2, 2.0), (4.0, 3000.0)))
    assert small == pytest.approx(large, rel=0.01)
    assert small == pytest.approx([1.0, 1.0, 1.0], rel=0.06)


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("seed", range(8))
def test_axles_of_random_four_wheel_cars_are_found(seed: int, tmp_path: Path) -> None:
    """Lengths of 0.2 to 4 m and masses of 2 kg to 3 t; loads move between their wheels, and slip takes its way."""
    front, rear, along = _found_of_the_plants(SimilarCar.random(seed), tmp_path)
    assert (front, rear) == pytest.approx((1.0, 1.0), rel=0.05)
    assert along == pytest.approx(1.0, rel=0.2)  # saturates in slip, and where wheels lift: Eq. 2 leaves it out


@pytest.mark.slow
@pytest.mark.parametrize("name", CARS)
def test_nothing_is_found_on_a_car_of_any_size_that_lacks_nothing(name: str, tmp_path: Path) -> None:
    car = CARS[name]
    vehicle = read_vehicle(_vehicle_file(tmp_path, car.vehicle), load_car())
    result = diagnose(make_record(_log(car), vehicle), "per_axle", default_tyre_prior("per_axle", vehicle, load_car()))
    assert result.verdict == "none"
    assert np.isfinite(as_revision(result, "per_axle", ()).covariance).all()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(volume(1, 2)))
def test_a_short_run_of_a_model_car_is_enough_for_what_it_determines(seed: int, tmp_path: Path) -> None:
    """A small car does in a second what a large one does in four: the interval of every parameter holds the truth."""
    car = CARS["1:10"]
    vehicle, columns = read_vehicle(_vehicle_file(tmp_path, car.vehicle), load_car()), car.drive(seed, seconds=20.0)
    log = DriveLog(columns, np.zeros(len(columns["t"]), np.int64))
    found = identify(log, vehicle, default_tyre_prior("per_axle", vehicle, load_car()), Options())
    truth = {
        f"{p}{axle}": v for axle in "fr" for p, v in zip("bcd", {"f": car.front, "r": car.rear}[axle], strict=True)
    }
    assert all(abs(found.final[name] - v) < 2.6 * found.fit.std[name] for name, v in truth.items())
    stiffness = [np.prod([found.final[f"{p}{axle}"] for p in "bcd"]) for axle in "fr"]
    np.testing.assert_allclose(stiffness, [np.prod(car.front), np.prod(car.rear)], rtol=0.03)


def test_too_short_a_run_is_refused_by_the_size_of_the_car(tmp_path: Path) -> None:
    car = CARS["1:10"]
    vehicle, columns = read_vehicle(_vehicle_file(tmp_path, car.vehicle), load_car()), car.drive(1, seconds=6.0)
    log = DriveLog(columns, np.zeros(len(columns["t"]), np.int64))
    with pytest.raises(InputError, match=r"a car of this size needs 5\.2 s"):
        identify(log, vehicle, default_tyre_prior("per_axle", vehicle, load_car()), Options())


@pytest.mark.slow
@pytest.mark.parametrize(("run", "share"), [("*fast*", 0.3), pytest.param("free*01_01", 1.0, marks=pytest.mark.long)])
def test_measured_runs_of_a_model_car_are_identified(
    measured_data: Path, tmp_path: Path, run: str, share: float
) -> None:
    """Of the second little is known of the tyres: the declared ones predict it as well."""
    (log,) = (measured_data / "dart").glob(f"{run}.csv")
    vehicle = read_vehicle(_vehicle_file(tmp_path, MODEL_CAR), load_car())
    result = identify(read_logs([log]), vehicle, default_tyre_prior("per_axle", vehicle, load_car()), Options())
    assert result.rmse["vy"][1] < share * result.rmse["vy"][0]
    assert not result.identifiability.identifiable["cx"]


def test_what_a_vehicle_file_leaves_out_is_in_proportion_to_the_car(tmp_path: Path) -> None:
    small = read_vehicle(_vehicle_file(tmp_path, MODEL_CAR), load_car())
    assert small.cg_height / small.wheelbase == pytest.approx(0.275 / 2.972, rel=1e-3)
    assert small.drag_area == pytest.approx(0.86 * (small.wheelbase / 2.972) ** 2, rel=1e-3)
    given = read_vehicle(_vehicle_file(tmp_path, {**MODEL_CAR, "cg_height": 0.03}), load_car())
    assert given.cg_height == 0.03


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("number", range(1, 4))
def test_measured_runs_of_a_model_car_are_diagnosed(measured_data: Path, tmp_path: Path, number: int) -> None:
    log = sorted((measured_data / "dart").glob("*.csv"))[number]
    vehicle = read_vehicle(_vehicle_file(tmp_path, MODEL_CAR), load_car())
    record = make_record(read_logs([log]), vehicle)
    result = diagnose(record, "per_axle", default_tyre_prior("per_axle", vehicle, load_car()))
    assert np.isfinite(as_revision(result, "per_axle", ()).covariance).all()
    ay = result.channels["ay"]
    assert ay["with_effects"] < 0.3 * ay["declared"]  # the prior is a full-size car's

"""A tyre property file gives the prior that its own formula has at the load of the car's wheels."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from estimator.model.tyre import normalised_force
from estimator.offline.record.declared import default_tyre_prior, read_tyre_prior
from hil_gateway.car.car import load_car
from hil_gateway.process.errors import InputError

SHORT = """[MDI_HEADER]
FILE_TYPE = 'tir'
[LATERAL_COEFFICIENTS]
PCY1 = 1.55   $Shape factor
PDY1 = 1.72
PKY1 = -24.1
"""
WHOLE = """[VERTICAL]
FNOMIN = 4000
[LONGITUDINAL_COEFFICIENTS]
PKX1 = 30
PKX2 = 2.0
[LATERAL_COEFFICIENTS]
PCY1 = 1.5
PDY1 = 1.6
PDY2 = -0.2
PKY1 = -30
PKY2 = 1.5
PKY4 = 2
"""
CAR = load_car().vehicle.model_copy(update={"mass": 800.0, "lf": 1.5, "lr": 1.5})
LOAD = 800.0 * 9.80665 / 4


def read(tmp_path: Path, text: str) -> dict[str, float]:
    path = tmp_path / "a.tir"
    path.write_text(text)
    return dict(read_tyre_prior(path, "per_axle", CAR, load_car()))


def test_a_file_of_three_coefficients_gives_its_stiffness_peak_and_shape(tmp_path: Path) -> None:
    prior = read(tmp_path, SHORT)
    for axle in "fr":
        curve = [prior[letter + axle] for letter in "bcd"]
        assert curve[1:] == [1.55, 1.72]
        assert normalised_force(np.array([1e-6]), *curve)[0] == pytest.approx(24.1e-6, rel=1e-6)
    assert prior["cx"] == default_tyre_prior("per_axle", CAR, load_car())["cx"]


def test_loads_count_where_the_file_has_them(tmp_path: Path) -> None:
    prior = read(tmp_path, WHOLE)
    # worked by hand: 1961 N of 4000 N, a wheel
    stiffness = 30 * 4000 * math.sin(2 * math.atan(LOAD / (1.5 * 4000))) / LOAD
    assert prior["bf"] * prior["cf"] * prior["df"] == pytest.approx(stiffness, rel=1e-3)
    assert prior["df"] == pytest.approx(1.6 + 0.2 * (1 - LOAD / 4000), rel=1e-3)
    assert prior["cx"] == pytest.approx(2 * LOAD * (30 - 2 * (1 - LOAD / 4000)), rel=1e-3)


def test_a_file_without_lateral_force_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="PKY1 is missing"):
        read(tmp_path, SHORT.replace("PKY1", "QKY1"))

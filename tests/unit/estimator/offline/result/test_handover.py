"""The model a diagnosis hands over is no surer than its residual allows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.drives.practice_drives import PRIOR, record_of, shared_drives

from estimator.offline.fit.prediction_error import Fit, Point
from estimator.offline.record.noise import ResidualNoise
from estimator.offline.result.handover import tempered
from estimator.offline.search.trial import Setting, fit_names


@pytest.fixture(scope="module")
def fits(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Any, Fit, Fit]]:
    """Drive, fit of the model without effects, and what would be handed over, with nothing and with much missing."""
    drives, out = shared_drives(tmp_path_factory), {}
    for name in ("nothing", "much"):
        drive = drives[name]
        setting = Setting(record_of(drive), "per_axle", PRIOR)
        found = fit_names(setting, (), None)
        handed = tempered(found.predictor.model, found.parameters, setting.record, found.deviation)
        out[name] = (drive, found, handed)
    return out


def test_a_model_that_explains_everything_is_handed_over_as_it_was_found(fits: dict[str, tuple[Any, Fit, Fit]]) -> None:
    _, found, handed = fits["nothing"]
    tyre = slice(0, len(found.predictor.model.tyre_table))
    std = np.sqrt(np.diag(found.covariance))[tyre]
    assert np.all(np.abs(handed.parameters - found.parameters)[tyre] < 2.0 * std)
    assert np.all(np.sqrt(np.diag(handed.covariance))[tyre] < 3.0 * std)


def test_a_residual_that_lasts_counts_as_fewer_samples(fits: dict[str, tuple[Any, Fit, Fit]]) -> None:
    _, found, handed = fits["much"]
    names = [p.name for p in found.predictor.model.tyre_table]
    # at the same point: a peak that the tyre never reaches is the less certain, the higher it is
    white = Point.at(found.predictor, handed.parameters, ResidualNoise.white(found.deviation)).normal()
    as_if_white = np.diag(np.linalg.pinv(white.precision(white.variance), hermitian=True))
    wider = np.sqrt(np.diag(handed.covariance) / as_if_white)[: len(names)]
    assert np.all(wider > 0.95)
    assert np.all(wider[[names.index(n) for n in ("bf", "cf", "df")]] > 1.3)

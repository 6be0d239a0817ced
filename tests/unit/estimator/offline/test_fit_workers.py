"""Fits in processes side by side find what fits one after the other find."""

from __future__ import annotations

import numpy as np
import pytest
from support.practice_drives import PRIOR, record_of, shared_drives

from estimator.offline.search.trial import Setting, fit_names
from estimator.offline.search.workers import Job, fit_each, workers


def test_fits_side_by_side_agree_with_fits_in_turn(tmp_path_factory: pytest.TempPathFactory) -> None:
    record = record_of(shared_drives(tmp_path_factory)["single"])
    setting = Setting(record.select(record.lap == 0), "per_axle", PRIOR)
    warm = fit_names(setting, (), None)
    jobs = [Job("resistance", ("rolling_resistance",)), Job("drag", ("aero_drag",))]
    said: list[str] = []
    in_turn = fit_each(setting, warm, jobs, said.append)
    with workers(2) as pool:
        beside = fit_each(Setting(setting.record, "per_axle", PRIOR, pool=pool), warm, jobs, said.append)
    assert said == ["resistance", "drag"] * 2
    for one, other in zip(in_turn, beside, strict=True):
        assert np.allclose(one.parameters, other.parameters, rtol=1e-9)
        assert np.allclose(one.held_out(), other.held_out(), rtol=1e-9)

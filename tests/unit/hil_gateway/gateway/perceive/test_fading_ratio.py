"""Least squares that forget."""

from __future__ import annotations

import numpy as np
import pytest

from hil_gateway.gateway.perceive.fading_ratio import FadingRatio


def test_the_ratio_is_that_of_the_newest_pairs_whatever_was_before():
    ratio, rng = FadingRatio(0.02), np.random.default_rng(1)
    for k in (3.0, -0.5):
        for x in rng.normal(0.0, 10.0, 1000):
            ratio.learn(k * x, x)
    assert (ratio.alone, ratio.ratio(7.0)) == (pytest.approx(-0.5, rel=1e-3), pytest.approx(-0.5, abs=0.1))


def test_where_there_was_nothing_it_is_as_expected_or_none():
    assert (FadingRatio(0.02).alone, FadingRatio(0.02).ratio(7.0)) == (0.0, 7.0)

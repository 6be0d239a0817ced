"""A verdict says first how much is explained, and what the rest costs."""

from __future__ import annotations

from estimator.offline.report.words import explained_words

ROW = {"declared": 9.0, "noise_floor": 0.1}
TIMES = {"driven": 90.0, "refit": 88.0, "with_effects": 90.25}
ROLLOUT = {"horizon_s": 1.0, "vx": {"declared": 2.0, "refit": 1.0, "with_effects": 0.25}}


def said(refit: float, with_effects: float) -> str:
    channels = {
        "ax": {**ROW, "refit": refit, "with_effects": with_effects},
        "ay": {**ROW, "refit": 0.1, "with_effects": 0.1},
    }
    return explained_words({
        "channels": channels, "rollout": ROLLOUT, "long_rollout": {**ROLLOUT, "horizon_s": 3.0}, "lap_time_s": TIMES,
    })  # fmt: skip


def test_the_share_is_that_of_the_variance_beyond_noise() -> None:
    assert "75 % in longitudinal specific force." in said(1.0, (0.125**2 + 0.25 * (1 - 0.125**2)) ** 0.5)
    assert "100 % in longitudinal" in said(1.0, 0.1)
    assert "vx 0.25 (1)" in said(1.0, 0.5)


def test_what_is_at_the_noise_or_not_explained_is_not_spoken_of() -> None:
    assert "lateral" not in said(1.0, 0.5)
    assert "explains" not in said(1.0, 1.0) + said(0.1, 0.1)


def test_the_rest_is_stated_as_error_of_prediction_and_as_lap_time() -> None:
    assert "after 1 s by vx 0.25 (1); after 3 s by vx 0.25 (1)" in said(1.0, 1.0)
    assert "A lap of 90.0 s takes +0.25 s (-2.00 s) by its forces." in said(1.0, 1.0)

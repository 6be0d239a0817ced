"""The loop closed by measured data: drive, diagnose, drive with what was found."""

from __future__ import annotations

import pytest

from benchmarks.campaign.closed import close_loop


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.xfail(strict=True, reason="the diagnosis names tyre_relaxation beside the drag")
def test_an_undeclared_effect_is_found_and_the_next_drive_is_predicted_better_and_no_slower() -> None:
    case = close_loop({"aero_drag": 1.2}, "paper", laps=2, seed=1, track="oval")
    assert case.found == ["aero_drag"]
    assert abs(case.parameters["aero_drag"]["k"]["value"] - 1.2) < 0.12
    assert case.kept, case.as_json()

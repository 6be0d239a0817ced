"""The progress bar of a diagnosis moves on to its end, whatever the number of steps."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.cli.diagnose import LATERAL_END, SHARES, DiagnosisProgress


@pytest.mark.parametrize("fits", [5, 400])
def test_the_bar_never_goes_back_nor_stands_still_and_ends_with_the_report(fits: int) -> None:
    seen: list[float] = []
    course = DiagnosisProgress(lambda _, share: seen.append(share))
    search = [f"fit {number}" for number in range(fits)]
    for what in ("reading", "log health", "road", *search, "last steps of the fit", "writing the report"):
        course(what)
    moves = np.diff(seen)
    assert min(moves) > 0.1 / max(fits, 100)
    assert seen[-1] == SHARES["writing the report"]


def test_an_identification_of_the_lateral_motion_has_a_part_of_the_bar_of_its_own() -> None:
    seen: list[float] = []
    course = DiagnosisProgress(lambda _, share: seen.append(share))
    course("lateral motion")
    course.lateral("simulations", 0.5)
    course.lateral("done", 1.0)
    course("road")
    first = SHARES["lateral motion"]
    assert seen == pytest.approx([first, (first + LATERAL_END) / 2, LATERAL_END, LATERAL_END])

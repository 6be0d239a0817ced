"""`hil campaign explore`: success is what the plant says of the limit, not what the belief says of itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.campaign.explore import SPEEDS, known_after, laps_to_the_limit, limit_errors, summarise
from estimator.belief.revision import starting_revision
from hil_gateway.config import load_config

LENGTH = 3500.0


def trial(method: str, seed: int, errors: list[float], laps: list[float], **changes: Any) -> dict[str, Any]:
    """A car with a limit of 80 s; a model a second."""
    t = [float(k) for k in range(1, len(errors) + 1)]
    return {
        "settings": {"method": method, "seed": seed, "track": "", "laps": 2}, "seconds": 200.0,
        "lap_times_s": laps, "lap_ratio": [lap / 80.0 for lap in laps], "limit_error": {"t": t, "error": errors},
        "off_track": 0, "spins": 0, "plan_failures": 0, "friction_over_s": 0.0, "failsafes": [], **changes,
    }  # fmt: skip


def test_a_limit_counts_as_known_once_it_stays_known() -> None:
    assert known_after(trial("plain", 1, [0.2, 0.04, 0.08, 0.03, 0.02], [])) == (4.0, True)
    assert known_after(trial("plain", 1, [0.2, 0.1, 0.01, 0.06], [])) == (4.0, False)


def test_the_first_lap_near_the_cars_own_limit_counts() -> None:
    assert laps_to_the_limit(trial("plain", 1, [0.1], [95.0, 84.0, 83.9])) == 2
    assert laps_to_the_limit(trial("plain", 1, [0.1], [95.0, 85.0])) is None


def test_cars_are_compared_with_themselves() -> None:
    cars = [trial("plain", n, [0.1] * n + [0.01], [90.0, 84.0]) for n in (4, 6, 8)]
    cars += [trial("infomax", n, [0.1] * (n // 2) + [0.01], [99.0, 84.0], spins=n == 8) for n in (4, 6, 8)]
    found = summarise(cars)["methods"]
    assert found["infomax"]["times_sooner_than_plain"]["median"] == pytest.approx(7 / 4)
    assert found["plain"]["times_sooner_than_plain"]["median"] == 1.0
    assert found["infomax"]["first_laps_over_plain"]["median"] == pytest.approx(183 / 174)
    assert (found["infomax"]["spins"], found["plain"]["spins"]) == (1, 0)


def test_the_error_of_a_model_grows_with_the_grip_it_believes() -> None:
    config = load_config()
    declared = starting_revision(config, "")
    tyre = {name: value * (1.1 if name.startswith("d") else 1.0) for name, value in declared.tyre.items()}
    stronger = declared.model_copy(update={"tyre": tyre})
    less, more = limit_errors([declared, stronger], np.full(len(SPEEDS), 10.0), config.vehicle, LENGTH)
    assert more - less > 0.1

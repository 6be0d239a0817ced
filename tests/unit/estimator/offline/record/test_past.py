"""What effects with memory make of the past is the same whatever was asked for before."""

from __future__ import annotations

import numpy as np

from estimator.model.declared_vehicle import all_candidates
from estimator.offline.record.past import KEPT, Past
from hil_gateway.car.car import load_car

LAG = all_candidates()["drive_delay"]


def _past() -> Past:
    t = np.arange(0.0, 20.0, 0.01)
    return Past({"t": t, "drive": np.sin(t)}, load_car().vehicle, lambda signal: signal.reshape(-1, 10).mean(axis=1))


def test_a_past_asked_for_again_is_that_of_its_own_parameters() -> None:
    past, names = _past(), LAG.remembers
    first = past([(LAG, (0.05,))], names)
    others = [past([(LAG, (0.001 * k,))], names) for k in range(1, 2 * KEPT)]
    np.testing.assert_array_equal(past([(LAG, (0.05,))], names), first)
    np.testing.assert_array_equal(past([(LAG, (0.001,))], names), others[0])
    assert not np.array_equal(others[0], first)


def test_an_effect_takes_what_the_one_before_it_leaves() -> None:
    """Tyres behind a steering that is late are those of a log whose steering is late itself."""
    t, late, tyres = np.arange(0.0, 20.0, 0.01), all_candidates()["steer_delay"], all_candidates()["tyre_relaxation"]
    signals = {"t": t, "vx": np.full(len(t), 20.0), "course_f": 0.02 * np.cos(t), "course_r": 0.01 * np.cos(t)}
    logged, shifted = ({**signals, "steer": 0.1 * np.sin(t - delay)} for delay in (0.0, 0.05))
    behind, alone = (
        Past(columns, load_car().vehicle, lambda signal: signal.reshape(-1, 10).mean(axis=1))(effects, tyres.remembers)
        for columns, effects in ((logged, [(late, (0.05,)), (tyres, (0.4,))]), (shifted, [(tyres, (0.4,))]))
    )
    np.testing.assert_allclose(behind.reshape(2, -1)[:, 10:], alone.reshape(2, -1)[:, 10:], atol=1e-6)
    assert _past()([], []).size == 0

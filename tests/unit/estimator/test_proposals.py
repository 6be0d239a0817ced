"""A proposed model takes the place of the one in use: when, with what is known of it, and when not."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.estimator_bench import Bench, Car

from estimator.belief.revision import RevisionPolicy, declared_revision
from estimator.model.parameters import tyre_prior
from hil_gateway.bus import topics
from hil_gateway.bus.messages import ActiveEffect, ModelRevision
from hil_gateway.bus.proposal import ModelProposal, Outcome
from hil_gateway.car.car import load_car
from hil_gateway.config import EstimatorConfig
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track


@pytest.fixture(scope="module")
def oval() -> Track:
    return load_track("oval")


def proposal(revision: ModelRevision, use_from_ns: int = 0) -> ModelProposal:
    return ModelProposal(
        stamp_ns=1, seq=0, outcome=Outcome.PROPOSED, lap=3, reason="better", revision=revision, use_from_ns=use_from_ns
    )


def with_offset(std: float = 0.01) -> ModelRevision:
    """The declared tyres and a steering offset, found to be about nothing, with what is known of all of them."""
    start = declared_revision(tyre_prior(load_car(), "per_axle"))
    effects = (ActiveEffect(name="steer_offset", parameters={"offset": 0.0}),)
    known = np.diag(np.square([*(0.1 * value for value in start.tyre.values()), std]))
    return start.model_copy(update={"effects": effects, "covariance": tuple(map(tuple, known.tolist()))})


@pytest.mark.parametrize("late", [0, 150])
def test_a_proposed_model_is_used_from_its_stamp_on_however_late_it_came_and_learning_goes_on(
    oval: Track, late: int
) -> None:
    bench, car = Bench(oval), Car(oval)
    states = [car.state() for _ in range(400)]
    estimates = bench.feed(*states[:late])
    bench.bus.publish(topics.MODEL_PROPOSAL, proposal(with_offset(), use_from_ns=states[200].stamp_ns))
    estimates += bench.feed(*states[late:])
    assert len(estimates) == 400, "the filter goes on meanwhile"
    revisions = bench.out[topics.MODEL_REVISION.key].poll(0)
    assert [[e.name for e in r.effects] == ["steer_offset"] for r in revisions] == [
        r.stamp_ns >= states[200].stamp_ns for r in revisions
    ]
    assert [r.seq for r in revisions] == list(range(1, len(revisions) + 1))
    assert revisions[-1].covariance[-1][-1] < 0.01**2, "the belief is about the effect too, and learns"


@pytest.mark.parametrize(
    "change",
    [
        {"layout": "shared"},
        {"tyre": {"cx": 1.0}},
        {"effects": (ActiveEffect(name="phlogiston", parameters={}),)},
        {"effects": (ActiveEffect(name="steer_offset", parameters={"angle": 0.0}),)},
        {"covariance": ((1.0,),)},
    ],
)
def test_a_model_that_learning_cannot_go_on_from_is_refused(oval: Track, change: dict[str, Any]) -> None:
    bench, car = Bench(oval), Car(oval)
    bench.bus.publish(topics.MODEL_PROPOSAL, proposal(with_offset().model_copy(update=change)))
    bench.feed(*(car.state() for _ in range(120)))
    assert len(bench.estimator.policy.current.effects) > 1, "still the declared car's"


def test_a_flood_of_models_that_are_refused_is_a_few_lines(oval: Track, caplog: pytest.LogCaptureFixture) -> None:
    bench, car = Bench(oval), Car(oval)
    for _ in range(500):
        bench.bus.publish(topics.MODEL_PROPOSAL, proposal(with_offset().model_copy(update={"layout": "shared"})))
        bench.estimator.step(0)
    bench.feed(car.state())
    assert len(caplog.messages) < 10
    assert "no. 256" in caplog.messages[-1]


def test_a_parameter_that_starts_at_nothing_moves_by_its_spread() -> None:
    policy = RevisionPolicy(EstimatorConfig(revision_max_step=0.05), with_offset(std=0.01))
    mean = np.array([*declared_revision(tyre_prior(load_car(), "per_axle")).tyre.values(), -0.004])
    believing: Any = SimpleNamespace(mean=mean, covariance=np.eye(len(mean)), samples=10_000)
    offsets = [policy.message(believing, k, k).effects[0].parameters["offset"] for k in range(20)]
    assert offsets[0] == pytest.approx(-0.0005), "a twentieth of the spread at once"
    assert offsets[-1] == pytest.approx(-0.004, abs=0.0003)

"""The estimator process core on vehicle states: life cycle, gates, revisions, alerts, determinism."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.estimator_bench import DT_NS, START_NS, VEHICLE, Bench, Car

from estimator.belief.revision import RevisionPolicy, declared_revision, load_revision, model_of, revision_id
from estimator.belief.tyre_belief import TyreBelief
from estimator.model.parameters import tyre_prior
from estimator.model.single_track import SingleTrack
from estimator.node import acting_variance, slope
from hil_gateway.bus import topics
from hil_gateway.bus.messages import ActiveEffect, Message, ModelRevision, SourceHealth
from hil_gateway.car.car import load_car
from hil_gateway.config import EstimatorConfig
from hil_gateway.process.errors import InputError
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track


@pytest.fixture(scope="module")
def oval() -> Track:
    return load_track("oval")


def test_estimate_follows_the_car_from_the_first_fix(oval: Track) -> None:
    bench, car = Bench(oval), Car(oval)
    estimates = bench.feed(*(car.state() for _ in range(800)))
    assert len(estimates) == 800
    assert all(e.valid for e in estimates[25:])
    here, last = oval.at(car.s - car.speed * 0.01), estimates[-1]
    assert np.hypot(last.x - here.x, last.y - here.y) < 0.1
    assert abs(last.vx - car.speed) < 0.15
    assert abs((last.yaw - here.heading + np.pi) % (2 * np.pi) - np.pi) < 0.03


def test_no_estimate_is_valid_before_a_position_fix(oval: Track) -> None:
    bench, car = Bench(oval), Car(oval, changes={"position_seq": 0})
    assert not any(e.valid for e in bench.feed(*(car.state() for _ in range(50))))


def test_a_position_fix_off_the_map_is_none(oval: Track) -> None:
    """At the end of what a message can say: a filter started there drifts out of it."""
    bench, car = Bench(oval), Car(oval, changes={"position_x": 1e7, "position_y": -1e7})
    assert not any(e.valid for e in bench.feed(*(car.state() for _ in range(50))))


def test_a_car_standing_against_the_track_is_found_by_its_course(oval: Track) -> None:
    """Heading is first taken from the track; motion the other way must turn it round, not confuse it."""
    bench, car = Bench(oval), Car(oval, s=2000.0)
    states = [car.state() for _ in range(600)]
    turned = ("yaw_rate", "ax", "ay", "steer")
    back = [
        s.model_copy(update={
            "stamp_ns": START_NS + i * DT_NS, "seq": i, "position_seq": i + 1, **{n: -getattr(s, n) for n in turned}
        })
        for i, s in enumerate(reversed(states))
    ]  # fmt: skip
    last = bench.feed(*back)[-1]
    heading = oval.at(2000.0).heading + np.pi
    assert last.valid
    assert abs((last.yaw - heading + np.pi) % (2 * np.pi) - np.pi) < 0.2


@pytest.mark.parametrize("gap_ns", [500_000_000, 5_000_000_000])
def test_a_gap_too_long_to_bridge_starts_the_filter_again(oval: Track, gap_ns: int) -> None:
    bench, car = Bench(oval), Car(oval)
    bench.feed(*(car.state() for _ in range(300)))
    car.s += car.speed * gap_ns * 1e-9
    late = [s.model_copy(update={"stamp_ns": s.stamp_ns + gap_ns}) for s in (car.state() for _ in range(300))]
    last = bench.feed(*late)[-1]
    here = oval.at(car.s - car.speed * 0.01)
    assert last.valid
    assert np.hypot(last.x - here.x, last.y - here.y) < 0.3


def test_a_dead_imu_invalidates_the_estimate_until_it_is_back(oval: Track) -> None:
    bench, car = Bench(oval), Car(oval)
    bench.feed(*(car.state() for _ in range(300)))
    dead = {"imu": SourceHealth(age_s=1.0, valid=False)}
    broken = [car.state().model_copy(update={"sources": dead, "valid": False}) for _ in range(50)]
    assert not any(e.valid for e in bench.feed(*broken))
    assert bench.feed(*(car.state() for _ in range(100)))[-1].valid


def test_a_repeated_state_changes_nothing(oval: Track) -> None:
    bench, car = Bench(oval), Car(oval)
    bench.feed(*(car.state() for _ in range(200)))
    state = car.state()
    first, again = bench.feed(state, state)
    assert (first.x, first.vx, first.std) == (again.x, again.vx, again.std)


@pytest.mark.promise("R4")
def test_same_states_give_byte_identical_outputs(oval: Track) -> None:
    def outputs() -> list[str]:
        bench, car = Bench(oval), Car(oval)
        estimates: list[Message] = list(bench.feed(*(car.state() for _ in range(600))))
        rest = [m for key in (topics.BELIEF.key, topics.MODEL_REVISION.key, topics.ALERT.key)
                for m in bench.out[key].poll(0)]  # fmt: skip
        return [m.model_dump_json() for m in estimates + rest]

    assert outputs() == outputs()


def test_belief_and_revision_keep_their_rates(oval: Track) -> None:
    bench, car = Bench(oval), Car(oval)
    bench.feed(*(car.state() for _ in range(500)))
    assert len(bench.out[topics.BELIEF.key].poll(0)) == 50
    assert len(bench.out[topics.MODEL_REVISION.key].poll(0)) == 5


def test_one_stamp_far_ahead_silences_neither_belief_nor_revisions(oval: Track) -> None:
    bench, car = Bench(oval), Car(oval)
    bench.feed(car.state().model_copy(update={"stamp_ns": 1 << 62}))
    for topic in (topics.BELIEF, topics.MODEL_REVISION):
        bench.out[topic.key].poll(0)
    bench.feed(*(car.state() for _ in range(200)))
    assert len(bench.out[topics.BELIEF.key].poll(0)) == 20
    assert len(bench.out[topics.MODEL_REVISION.key].poll(0)) == 2


def test_slope_needs_even_spacing() -> None:
    even = [k * DT_NS for k in range(7)]
    assert slope(even, [3.0 * k for k in range(7)]) == pytest.approx(300.0)
    assert slope([*even[:5], *(t + 2 * DT_NS for t in even[5:])], [0.0] * 7) is None
    assert slope([0] * 7, [0.0] * 7) is None


def test_an_input_is_certain_while_it_stands_and_uncertain_by_what_it_has_moved() -> None:
    assert acting_variance([0.1] * 9) == 0.0
    assert acting_variance([-0.3] * 5 + [0.1] * 5) == pytest.approx(10 * 0.2**2)


class Believing(TyreBelief):
    """A belief set by hand."""

    def __init__(self, mean: dict[str, float], samples: int) -> None:
        super().__init__(SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")))
        self.deviation = (np.array([mean[n] for n in self.names]) - self.prior) / self.scale
        self.samples = samples


def scaled(factor: float) -> dict[str, float]:
    return {name: factor * value for name, value in tyre_prior(load_car(), "per_axle").items()}


def test_revision_waits_for_samples_and_for_a_change_worth_sending() -> None:
    policy = RevisionPolicy(EstimatorConfig(), declared_revision(tyre_prior(load_car(), "per_axle")))
    declared = policy.current.revision
    assert policy.message(Believing(scaled(1.5), samples=10), 0, 1).revision == declared
    assert policy.message(Believing(scaled(1.01), samples=10_000), 0, 1).revision == declared
    assert policy.message(Believing(scaled(1.03), samples=10_000), 0, 1).revision != declared


def test_revision_moves_by_bounded_steps_and_stays_within_bounds() -> None:
    policy = RevisionPolicy(EstimatorConfig(), declared_revision(tyre_prior(load_car(), "per_axle")))
    believing = Believing(scaled(2.9), samples=10_000)
    values = [policy.current.tyre["df"], *(policy.message(believing, k, k).tyre["df"] for k in range(60))]
    assert max(b / a for a, b in pairwise(values)) <= 1.2 + 1e-9
    assert values[-1] <= 2.0 * values[0]
    assert values[-1] > 1.8 * values[0]


def test_learning_switched_off_keeps_the_model() -> None:
    policy = RevisionPolicy(EstimatorConfig(learn=False), declared_revision(tyre_prior(load_car(), "per_axle")))
    assert policy.message(Believing(scaled(1.5), samples=10_000), 0, 1).tyre == policy.current.tyre == scaled(1.0)


def test_revision_id_is_of_content_only() -> None:
    effect = ActiveEffect(name="aero_drag", parameters={"k": 0.5})
    one, other = revision_id("per_axle", scaled(1.0), (effect,)), revision_id("per_axle", scaled(1.0))
    assert one == revision_id("per_axle", dict(reversed(scaled(1.0).items())), (effect,))
    assert one != other


def test_revision_file_round_trips_and_bad_ones_are_named(tmp_path: Path) -> None:
    effect = ActiveEffect(name="road_grade", parameters={}, profile=(0.0, 0.1, 0.0, -0.1, 0.0))
    drag = ActiveEffect(name="aero_drag", parameters={"k": 0.6})
    file = tmp_path / "model.json"
    revision = written(file, (effect, drag))
    revised = model_of(load_revision(file), VEHICLE, 100.0)
    phi = revised.phi_at(np.array([20.0, 60.0, 120.0]))
    assert phi.shape == (2, 3)
    assert phi[0, 0] == pytest.approx(phi[0, 2])
    assert phi[0, 0] > 0 > phi[0, 1]
    assert np.all(phi[1] == 0.6)
    written(file, (drag.model_copy(update={"name": "phlogiston"}),))
    with pytest.raises(InputError, match="not in the catalogue"):
        load_revision(file)
    file.write_text(revision.model_copy(update={"tyre": scaled(1.1)}).model_dump_json())
    with pytest.raises(InputError, match="it was edited"):
        load_revision(file)
    covariance = tuple(tuple(float(i == j) for j in range(8)) for i in range(8))
    file.write_text(
        declared_revision(tyre_prior(load_car(), "per_axle"))
        .model_copy(update={"covariance": covariance})
        .model_dump_json()
    )
    with pytest.raises(InputError, match="covariance has 8 rows for 7 parameters"):
        load_revision(file)
    file.write_text("{}")
    with pytest.raises(InputError, match="not a model revision"):
        load_revision(file)
    with pytest.raises(InputError, match="cannot read"):
        load_revision(tmp_path / "absent.json")


def written(file: Path, effects: tuple[ActiveEffect, ...]) -> ModelRevision:
    """The declared model with effects, as a file."""
    declared = declared_revision(tyre_prior(load_car(), "per_axle"))
    made = {"effects": effects, "revision": revision_id(declared.layout, declared.tyre, effects)}
    revision = declared.model_copy(update=made)
    file.write_text(revision.model_dump_json())
    return revision


def test_estimator_starts_from_a_revision_file(oval: Track, tmp_path: Path) -> None:
    revision: ModelRevision = declared_revision(scaled(1.1))
    file = tmp_path / "model.json"
    file.write_text(revision.model_dump_json())
    bench = Bench(oval, model=str(file))
    assert bench.estimator.policy.current.tyre["df"] == pytest.approx(scaled(1.1)["df"])
    assert bench.estimator.belief.mean[0] == pytest.approx(scaled(1.1)["cx"])


def test_a_fix_of_a_period_before_its_state_says_where_the_car_was_then(oval):
    """40 m/s are 0.4 m a period."""
    car, straight, late = Car(oval, speed=40.0), Bench(oval), Bench(oval)
    states = [car.state() for _ in range(300)]
    told = [
        state.model_copy(update={
            "position_x": before.position_x, "position_y": before.position_y, "position_stamp_ns": before.stamp_ns,
        })
        for before, state in pairwise(states)
    ]  # fmt: skip
    now, then = straight.feed(*states)[-1], late.feed(*told)[-1]
    assert now.valid and then.valid
    assert np.hypot(now.x - then.x, now.y - then.y) < 0.1

"""The state filter at rest, creeping, pushed either way, restarted and with gaps: it knows its heading or says so.

The car is pushed by rigid kinematics on the steepest bank (20 degrees) and grade (10 degrees) of the shipped tracks,
its sensors have offsets, its fixes wander by 0.3 m a minute and drift by 1 cm/s.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from support.cars.pushed_car import Errors, PushedCar
from support.promise_figures import record_figure, volume

from estimator.state.localisation import Localisation
from hil_gateway.bus.messages import Estimate, Heading, SourceHealth, VehicleState
from hil_gateway.car.car import load_car
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track

HEADING = 0.02
"""rad that the promise allows"""
Place = tuple[Track, float]


def _steepest(name: str, slope: str) -> Place:
    track = load_track(name)
    return track, float(track.s[np.argmax(np.abs(getattr(track, slope)))])


@pytest.fixture(scope="module", params=[("tri_oval", "bank"), ("road_course", "grade")], ids=["bank", "grade"])
def steep(request: pytest.FixtureRequest) -> Place:
    return _steepest(*request.param)


def _pushed(until: float, metres: float, then: Callable[[float], float] = lambda t: 0.0) -> Callable[[float], float]:
    """Stands for 3 s, is pushed by so many m at 1 m/s, then moves as told."""
    end = 3.0 + abs(metres)
    return lambda t: 0.0 if t < 3.0 else float(np.sign(metres)) if t < end else 0.0 if t < until else then(t)


def _estimates(car: PushedCar, localisation: Localisation, states: Iterable[VehicleState]) -> list[Estimate]:
    return [localisation.step(state, car.k) for state in states]


def _wrong(car: PushedCar, estimate: Estimate) -> float:
    return abs(car.heading_error(estimate.yaw))


@pytest.mark.parametrize("turned", [0.0, np.pi / 2, np.pi, -2.0])
@pytest.mark.parametrize("speed", [1.4, -1.0])
def test_a_heading_is_not_known_before_the_first_metres_and_is_after_them(
    steep: Place, turned: float, speed: float
) -> None:
    track, s = steep
    car = PushedCar(track, s, turned, Errors(drift=0.01), 1, lambda t: 0.0 if t < 3.0 else speed)
    localisation = Localisation(load_car(), track)
    standing = _estimates(car, localisation, car.states(3.0))
    assert {e.lacks for e in standing} == {"heading"}
    assert not any(e.valid for e in standing)
    assert min(e.std[2] for e in standing) > 1.0
    while car.rolled < 6.0 and not (last := localisation.step(car.state(), car.k)).valid:
        pass
    assert last.valid
    assert car.rolled > 0.5
    assert _wrong(car, last) < 3.0 * last.std[2] < 0.1
    assert last.vx == pytest.approx(car.vx, abs=0.05)


@pytest.mark.slow
@pytest.mark.promise("G2")
@pytest.mark.parametrize(
    "then",
    [
        pytest.param(0.0, id="standing"),
        pytest.param(0.05, id="creeping", marks=pytest.mark.long),
        pytest.param(-0.05, id="creeping back"),
    ],
)
def test_heading_stays_right_or_is_said_to_be_lost_for_minutes(steep: Place, then: float) -> None:
    track, s = steep
    errors = Errors(drift=0.01, drift_yaw=float(track.at(s).heading) + np.pi / 2)
    car = PushedCar(track, s, 0.3, errors, 2, _pushed(40.0, 30.0, lambda t: then))
    localisation = Localisation(load_car(), track)
    _estimates(car, localisation, car.states(40.0))
    found, minutes = [], volume(1, 10)
    for state in car.states(60.0 * minutes):
        estimate = localisation.step(state, car.k)
        if estimate.valid:
            found.append(_wrong(car, estimate))
            assert found[-1] < 3.0 * estimate.std[2]
    share = len(found) / (6_000 * minutes)
    assert share > 0.1, "not once is nothing known"
    if then == 0.0:
        assert share == 1.0, "a car that stands forgets nothing"
    figure = f"heading {max(found):.4f} rad, valid {share:.0%}"
    record_figure("G2", f"{track.name}, {then:+.2f} m/s for {minutes} min: {figure}", missed=max(found) >= HEADING)


@pytest.mark.promise("G2")
@pytest.mark.parametrize("way", [30.0, -30.0])
def test_a_car_pushed_either_way_knows_its_heading_and_its_speed(steep: Place, way: float) -> None:
    track, s = steep
    car = PushedCar(track, s, 0.1, Errors(drift=0.01), 3, _pushed(40.0, way))
    localisation = Localisation(load_car(), track)
    last = _estimates(car, localisation, car.states(38.0))[-1]
    assert car.rolled == pytest.approx(30.0, abs=1.0)
    assert last.valid
    assert _wrong(car, last) < HEADING
    assert abs(last.vx) < 0.03
    record_figure("G2", f"{track.name}, pushed {way:+.0f} m: heading {_wrong(car, last):.4f} rad")


@pytest.mark.promise("N3")
def test_heading_and_speed_are_consistent_at_rest_and_at_walking_pace() -> None:
    """Normalised errors squared of heading and speed, over cars whose fixes wander as the filter assumes."""
    track, s = _steepest("road_course", "grade")
    phases = {"pushed": 20.0, "standing": 38.0, "back": 52.0}
    squares: dict[str, list[float]] = {name: [] for name in phases}
    runs = volume(6, 24)
    for seed in range(runs):
        rng = np.random.default_rng([seed, 39])
        drift, drift_yaw = float(rng.normal(0.0, 0.01)), float(rng.uniform(0, 6))
        errors = Errors(*rng.normal(0.0, [0.15, 0.15, 0.004]), drift=drift, drift_yaw=drift_yaw)
        walk = _pushed(40.0, 18.0, lambda t: -1.0)
        car = PushedCar(track, s, float(rng.uniform(-3, 3)), errors, seed, walk)
        localisation = Localisation(load_car(), track)
        for state in car.states(max(phases.values())):
            estimate = localisation.step(state, car.k)
            for name, at in phases.items():
                if car.k == round(at * 100):
                    squares[name].append((_wrong(car, estimate) / estimate.std[2]) ** 2)
    high = stats.chi2.ppf(0.975, runs) / runs
    means = {name: float(np.mean(values)) for name, values in squares.items()}
    record_figure("N3", f"heading at walking pace, {runs} runs, NEES below {high:.2f}: {means}")
    assert max(means.values()) < high


ON_THE_BANK = pytest.mark.parametrize("steep", [("tri_oval", "bank")], ids=["bank"], indirect=True)


@ON_THE_BANK
def test_fixes_that_wander_do_not_restart_the_filter_of_a_standing_car(steep: Place) -> None:
    track, s = steep
    car = PushedCar(track, s, 0.0, Errors(wander=0.08, drift=0.02), 4, _pushed(15.0, 10.0))
    localisation = Localisation(load_car(), track)
    _estimates(car, localisation, car.states(20.0))
    for state in car.states(100.0):
        estimate = localisation.step(state, car.k)
        assert estimate.valid
        assert _wrong(car, estimate) < 3.0 * estimate.std[2]


def test_a_car_carried_away_while_it_stands_no_longer_knows_its_heading(steep: Place) -> None:
    track, s = steep
    car = PushedCar(track, s, 0.0, Errors(), 5, _pushed(15.0, 10.0))
    localisation = Localisation(load_car(), track)
    assert _estimates(car, localisation, car.states(16.0))[-1].valid
    car.x, car.y, car.yaw = car.x + 30.0, car.y, car.yaw + 1.5
    assert _estimates(car, localisation, car.states(2.0))[-1].lacks == "heading"


@pytest.mark.parametrize("frames", [1, 3])
def test_a_few_samples_out_of_range_are_bridged_and_counted(steep: Place, frames: int) -> None:
    track, s = steep
    car = PushedCar(track, s, 0.0, Errors(), 6, _pushed(100.0, 90.0))
    localisation, seeing = Localisation(load_car(), track), Localisation(load_car(), track)
    for state in car.states(25.0):
        localisation.step(state, 0), seeing.step(state, 0)
    held = {"sources": {"imu": SourceHealth(age_s=0.02, valid=False)}}
    for state in car.states(0.01 * frames):
        bridged, seen = localisation.step(state.model_copy(update=held), 0), seeing.step(state, 0)
    assert (bridged.bridged, seen.bridged) == (frames, 0)
    assert all(b > s for b, s in zip(bridged.std[2:5], seen.std[2:5], strict=True))
    after = _estimates(car, localisation, car.states(1.0))
    assert all(e.valid and e.bridged == frames for e in after)
    assert _wrong(car, after[-1]) < HEADING


def test_old_states_of_a_burst_change_nothing(steep: Place) -> None:
    track, s = steep
    car = PushedCar(track, s, 0.0, Errors(), 7, _pushed(100.0, 90.0))
    localisation = Localisation(load_car(), track)
    states = list(car.states(20.0))
    _estimates(car, localisation, states[:-1])
    old = [localisation.step(state, 0) for state in states[-50:-1]]
    after = localisation.step(states[-1], 0)
    assert len({(e.x, e.y, e.yaw, e.vx) for e in old}) == 1
    assert after.valid
    assert after.bridged == 0


def test_a_standing_car_survives_a_break_of_the_states(steep: Place) -> None:
    track, s = steep
    car = PushedCar(track, s, 0.0, Errors(), 8, _pushed(15.0, 10.0))
    localisation = Localisation(load_car(), track)
    before = _estimates(car, localisation, car.states(20.0))[-1]
    list(car.states(5.0))
    after = localisation.step(car.state(), 0)
    assert after.valid
    assert after.yaw == pytest.approx(before.yaw, abs=before.std[2])


def test_a_restarted_estimator_goes_on_with_what_the_last_one_knew(steep: Place) -> None:
    track, s = steep
    car = PushedCar(track, s, 0.0, Errors(), 9, _pushed(15.0, 10.0))
    known = _estimates(car, Localisation(load_car(), track), car.states(20.0))[-1]
    first = Localisation(load_car(), track).step(_with(car.state(), known), 0)
    assert first.valid
    assert first.yaw == pytest.approx(known.yaw)
    assert first.bias_yaw_rate == pytest.approx(car.errors.yaw_rate, abs=2e-4)


def test_what_the_last_one_knew_of_another_place_is_not_taken(steep: Place) -> None:
    track, s = steep
    car = PushedCar(track, s, 0.0, Errors(), 9, _pushed(15.0, 10.0))
    known = _estimates(car, Localisation(load_car(), track), car.states(20.0))[-1]
    elsewhere = known.model_copy(update={"x": known.x + 5.0})
    assert Localisation(load_car(), track).step(_with(car.state(), elsewhere), 0).lacks == "heading"


def _with(state: VehicleState, known: Estimate) -> VehicleState:
    return state.model_copy(update={"stood": known, "position_seq": state.position_seq + 1})


@ON_THE_BANK
def test_wheels_that_say_nothing_below_their_threshold_leave_the_heading_alone(steep: Place) -> None:
    """0.25 m/s with wheel speeds that begin at 0.3: the car goes 15 m, and its wheels stand."""
    track, s = steep
    errors = replace(Errors(), wheel_least=0.3)
    car = PushedCar(track, s, 0.0, errors, 10, _pushed(35.0, 30.0, lambda t: 0.25))
    localisation = Localisation(load_car(), track)
    assert _estimates(car, localisation, car.states(36.0))[-1].valid
    last = _estimates(car, localisation, car.states(60.0))[-1]
    assert _wrong(car, last) < HEADING
    assert np.hypot(last.x - car.place[0], last.y - car.place[1]) < 0.3


class HeadedCar(PushedCar):
    """One with a receiver that says where it points, turned and wandering as inertial solutions on a car are."""

    MOUNTED, WANDER, WANDER_S, NOISE, STATED = 0.007, 0.0014, 60.0, 2e-4, 0.0014
    """rad of the first two, s, rad; what the receiver says of itself"""

    def __init__(  # noqa: PLR0917 - as of its base
        self, track: Track, s: float, turned: float, errors: Errors, seed: int, speed: Callable[[float], float]
    ) -> None:
        super().__init__(track, s, turned, errors, seed, speed)
        self._draw = np.random.default_rng([seed, 17])
        self.off, self._wanders = self.MOUNTED * self._draw.normal(), self.WANDER * self._draw.normal()

    def headed(self, seconds: float, jump: float = 0.0) -> Iterator[VehicleState]:
        """States with a heading, wrong by `jump` more."""
        kept = np.exp(-0.01 / self.WANDER_S)
        for state in self.states(seconds):
            self._wanders = kept * self._wanders + self.WANDER * np.sqrt(1.0 - kept**2) * self._draw.normal()
            yaw = self.yaw + self.off + self._wanders + self.NOISE * self._draw.normal() + jump
            heading = Heading(yaw=float(np.remainder(yaw, 2 * np.pi)), std=self.STATED)
            yield state.model_copy(update={"heading": heading, "receiver": "novatel_top"})


@pytest.mark.promise("G2")
@pytest.mark.promise("N3")
def test_a_receivers_heading_is_the_cars_at_once_and_better_known_after_the_first_metres() -> None:
    """Normalised errors squared of a car that has never moved, then of one at rest; and against no such receiver."""
    track, s = _steepest("road_course", "grade")
    phases, runs = {"at the start": 2.0, "after a stand": volume(30, 45)}, volume(4, 24)
    squares: dict[str, list[float]] = {name: [] for name in phases}
    wrong: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(runs):
        rng = np.random.default_rng([seed, 47])
        drift, drift_yaw = float(rng.normal(0.0, 0.01)), float(rng.uniform(0, 6))
        errors = Errors(*rng.normal(0.0, [0.15, 0.15, 0.004]), drift=drift, drift_yaw=drift_yaw)
        turned = float(rng.uniform(-3, 3))
        for headed in (True, False):
            car = HeadedCar(track, s, turned, errors, seed, _pushed(60.0, 12.0))
            localisation = Localisation(load_car(), track)
            for state in (car.headed if headed else car.states)(max(phases.values())):
                estimate = localisation.step(state, car.k)
                if headed and (name := next((n for n, t in phases.items() if car.k == round(t * 100)), "")):
                    assert estimate.valid, name
                    squares[name].append((_wrong(car, estimate) / estimate.std[2]) ** 2)
            wrong[headed].append(_wrong(car, estimate))
    high = stats.chi2.ppf(0.975, runs) / runs
    means = {name: float(np.mean(values)) for name, values in squares.items()}
    of_both = " against ".join(f"{np.sqrt(np.mean(np.square(wrong[k]))):.4f}" for k in (True, False))
    record_figure("N3", f"heading of a receiver, {runs} runs, NEES below {high:.2f}: {means}; {of_both} rad without")
    assert max(means.values()) < high
    assert np.sum(np.square(wrong[True])) < np.sum(np.square(wrong[False]))


def test_a_heading_that_jumps_is_refused_and_counted(steep: Place) -> None:
    track, s = steep
    car = HeadedCar(track, s, 0.2, Errors(), 11, _pushed(15.0, 10.0))
    localisation = Localisation(load_car(), track)
    before = _estimates(car, localisation, car.headed(16.0))[-1]
    after = _estimates(car, localisation, car.headed(3.0, jump=0.1))[-1]
    assert after.innovations_rejected >= before.innovations_rejected + 300
    assert _wrong(car, after) < 3.0 * after.std[2]
    assert after.yaw == pytest.approx(before.yaw, abs=before.std[2])


def test_headings_of_another_receiver_are_taken_with_its_own_mounting(steep: Place) -> None:
    """The receiver in use is lost while the car stands; that of the other one is turned by 0.02 rad."""
    track, s = steep
    car = HeadedCar(track, s, 0.2, Errors(), 12, _pushed(15.0, 10.0))
    localisation = Localisation(load_car(), track)
    before = _estimates(car, localisation, car.headed(16.0))[-1]
    other = (s.model_copy(update={"receiver": "novatel_bottom"}) for s in car.headed(3.0, jump=0.02))
    after = _estimates(car, localisation, other)[-1]
    assert after.innovations_rejected == before.innovations_rejected
    assert after.yaw == pytest.approx(before.yaw, abs=2.0 * before.std[2])

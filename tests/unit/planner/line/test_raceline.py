"""Race line: closed, inside the track, within the envelope, faster than the centre line, on any track."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from estimator.belief.revision import model_of, race_car_revision
from estimator.model.parameters import tyre_prior
from estimator.model.single_track import SingleTrack
from hil_gateway.car.car import load_car
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.track.loading import load_track
from hil_gateway.track.track import Track
from planner.line.envelope import MIN_NORMAL, Envelope, envelope_of, normal_share, required_lateral
from planner.line.longitudinal_reserve import SHARES, SPEEDS
from planner.line.raceline import OptimisedLine, centre_line, compute_raceline, raceline_for
from planner.line.speed_profile import RoadPath, cornering_speed, lap_time_of, speed_profile

MARGIN = 1.5
TYRE = tyre_prior(load_car(), "per_axle")


@pytest.fixture(scope="module", autouse=True)
def _private_cache(tmp_path_factory: pytest.TempPathFactory) -> object:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


def declared_envelope(**changes: float) -> Envelope:
    model = SingleTrack(load_car().vehicle, tyre_prior(load_car(), "per_axle"))
    tyre = {**TYRE, **changes}
    return envelope_of(model, [tyre[p.name] for p in model.tyre_table], car=load_car())


def race_car_envelope(use: float = 0.9) -> Envelope:
    revised = model_of(race_car_revision(load_car(), "per_axle"), load_car().vehicle, 1000.0)
    phi = revised.phi_at(np.zeros(1))[:, 0]
    return envelope_of(revised.model, list(revised.theta), list(phi), use=(use, use), car=load_car())


def circle(radius: float, bank: float = 0.0, bend: float = 0.0, n: int = 200, trust: float = 1.0) -> RoadPath:
    ones = np.ones(n)
    return RoadPath(ones / radius, 0.0 * ones, bank * ones, bend * ones, 2 * np.pi * radius, trust)


def normal(path: RoadPath | OptimisedLine, v: np.ndarray) -> np.ndarray:
    """Axle load over the weight, without downforce."""
    level, dip = normal_share(path.grade, path.bank, path.bend, path.curvature)
    return np.maximum(level + dip * v**2, MIN_NORMAL)


def assert_sound(line: OptimisedLine, track: Track, envelope: Envelope) -> None:
    assert np.allclose(np.diff(line.s), line.length / len(line.s))
    steps = np.hypot(np.diff(line.x, append=line.x[0]), np.diff(line.y, append=line.y[0]))
    assert np.ptp(steps) < 0.05, "uniform and closed"
    turned = np.sum(line.curvature) * line.length / len(line.s)
    assert abs(abs(turned) - 2 * np.pi) < 0.02
    assert min(line.width_left.min(), line.width_right.min()) > MARGIN - 0.15
    lateral = required_lateral(line.curvature, line.bank, line.vx_profile)
    (c0, c2), v = envelope.lateral, line.vx_profile
    assert np.all(np.abs(lateral) <= (normal(line, v) * c0 + c2 * v**2) * 1.001 + 1e-6)
    acceleration = np.gradient(line.vx_profile**2 / 2, line.s)[2:-2]
    assert acceleration.max() < envelope.traction + GRAVITY * np.abs(np.sin(line.grade)).max() + 0.5


@pytest.mark.parametrize("name", ["road_course", "oval"])
def test_race_line_stays_inside_and_beats_the_centre_line(name: str) -> None:
    track = load_track(name)
    line = compute_raceline(track, load_car(), TYRE, MARGIN)
    assert_sound(line, track, declared_envelope())
    assert line.lap_time < 0.985 * centre_line(track, declared_envelope()).lap_time


def test_race_line_of_a_noisy_surveyed_track_is_sound(tmp_path: Path) -> None:
    track, rng = load_track("road_course"), np.random.default_rng(3)
    step = slice(None, None, 5)
    columns = [track.x, track.y, track.width_right, track.width_left]
    rows = np.column_stack([c[step] + rng.normal(0, 0.15, len(track.x[step])) for c in columns])
    file = tmp_path / "noisy.csv"
    np.savetxt(file, rows, delimiter=",", header="x_m,y_m,w_tr_right_m,w_tr_left_m", comments="")
    noisy = load_track(file)
    line = compute_raceline(noisy, load_car(), TYRE, MARGIN)
    assert_sound(line, noisy, declared_envelope())
    assert np.max(np.abs(line.curvature)) < 0.08


@pytest.mark.long
def test_race_lines_of_measured_tracks_are_sound(measured_tracks: Path) -> None:
    for file in sorted(measured_tracks.glob("*.csv")):
        track = load_track(file)
        assert_sound(compute_raceline(track, load_car(), TYRE, MARGIN), track, declared_envelope())


def test_more_grip_gives_a_shorter_lap_and_is_not_taken_from_the_cache_of_less() -> None:
    track = load_track("oval")
    times = [raceline_for(track, declared_envelope(df=d, dr=d), MARGIN).lap_time for d in (1.0, 1.2, 1.4)]
    assert times[0] > times[1] > times[2]


def test_cached_line_is_the_computed_line() -> None:
    track = load_track("oval")
    first, second = (compute_raceline(track, load_car(), TYRE, 2.0) for _ in range(2))
    assert np.array_equal(first.x, second.x)
    assert first.lap_time == second.lap_time


def test_speed_on_a_circle_is_the_closed_form() -> None:
    envelope = declared_envelope()
    path = circle(60.0)
    v, length = speed_profile(path, envelope), path.length
    limit = np.sqrt(envelope.lateral[0] * 60.0)
    assert np.all((v > 0.998 * limit) & (v <= limit)), "a little grip goes into pushing against drag"
    assert lap_time_of(v, length) == pytest.approx(length / v.mean(), rel=1e-4)


@pytest.mark.parametrize("radius", [60.0, 120.0, 160.0])
def test_the_declared_race_car_corners_with_its_downforce(radius: float) -> None:
    """On a flat circle each axle bears its share of m v^2/r with D (1 - k dL/L0) L, L = L0 + its downforce."""
    car, use, k = load_car().vehicle, 0.9, load_car().tyres.load_sensitivity
    pressure = 0.5 * car.air_density

    def spare(v: float, axle: tuple[float, float, float, float]) -> float:
        d, static, area, share = axle
        gained = pressure * area * v * v / static
        return use * d * (1.0 - k * gained) * static * (1.0 + gained) - share * car.mass * v * v / radius

    axles = (
        (TYRE["df"], car.static_load_front, -car.lift_area_front, car.lr / car.wheelbase),
        (TYRE["dr"], car.static_load_rear, -car.lift_area_rear, car.lf / car.wheelbase),
    )
    fastest = min(float(brentq(spare, 1.0, 75.0, args=(axle,))) for axle in axles)
    found = cornering_speed(circle(radius), race_car_envelope(use))
    assert np.all((found > 0.99 * fastest) & (found <= 1.0005 * fastest)), "two numbers a limit, never above it"
    assert found[0] > 1.02 * cornering_speed(circle(radius), declared_envelope())[0]


@pytest.mark.parametrize("bank", [0.05, 0.15])
def test_a_bank_is_never_worth_more_than_on_an_incline(bank: float) -> None:
    """v^2 = g r (mu cos b + sin b) / (cos b - mu sin b); a profile takes cos b for 1 where that is slower."""
    envelope, radius = declared_envelope(), 100.0
    mu = envelope.lateral[0] / GRAVITY
    helped = mu * np.cos(bank) + np.sin(bank)
    incline = np.sqrt(GRAVITY * radius * helped / (np.cos(bank) - mu * np.sin(bank)))
    found = cornering_speed(circle(radius, -bank), envelope)
    assert np.all((found > 0.99 * incline) & (found <= incline))


@pytest.mark.parametrize("df", [0.8, 2.0])
def test_each_axle_keeps_to_an_ellipse_of_its_own(df: float) -> None:
    """Eq. (1) drives and brakes with the rear axle: what is left is the ellipse of that axle, whichever is weaker."""
    car, envelope = load_car().vehicle, declared_envelope(df=df)
    front, rear = df * car.static_load_front / car.lr, TYRE["dr"] * car.static_load_rear / car.lf
    used_behind = SHARES * min(front / rear, 1.0)
    for table in (envelope.brake_left, envelope.drive_left):
        left = np.sqrt(1.0 - used_behind**2)
        np.testing.assert_allclose(np.array(table), np.repeat(left[None], len(SPEEDS), axis=0), atol=0.01)


def test_braking_leaves_more_to_a_car_whose_front_axle_gives_way_first() -> None:
    """Braking loads the front axle: at nine tenths of its bends such a car has more left than one ellipse gives it, and
    one whose rear axle does has less, up to 45 m/s: faster, that axle works against the air in any bend."""
    revised = model_of(race_car_revision(load_car(), "per_axle"), load_car().vehicle, 1000.0)
    phi, at = list(revised.phi_at(np.zeros(1))[:, 0]), int(np.argmin(np.abs(SHARES - 0.9)))
    left = {
        use: np.array(envelope_of(revised.model, list(revised.theta), phi, use=use, car=load_car()).brake_left)[:3, at]
        for use in ((0.7, 0.95), (0.95, 0.7))
    }
    one_ellipse = np.sqrt(1.0 - 0.9**2)
    assert np.all(left[0.7, 0.95] > one_ellipse)
    assert np.all(left[0.95, 0.7] < one_ellipse)


def test_a_crest_slows_a_turn_and_a_dip_quickens_it_by_what_they_do_to_the_load() -> None:
    envelope, radius = declared_envelope(), 100.0
    mu = envelope.lateral[0] / GRAVITY
    for bend in (-0.003, 0.0, 0.002):
        expected = np.sqrt(mu * GRAVITY * radius / (1.0 - mu * bend * radius))
        assert cornering_speed(circle(radius, bend=bend), envelope) == pytest.approx(expected, rel=1e-6)


def test_bank_towards_the_inside_of_the_turn_is_faster() -> None:
    envelope = declared_envelope()
    speeds = [float(speed_profile(circle(100.0, bank), envelope).mean()) for bank in (0.1, 0.0, -0.1)]
    assert speeds[0] < speeds[1] < speeds[2]


def test_a_banked_turn_presses_the_car_on_the_road() -> None:
    """Lateral force needed and force the tyres give under weight and centripetal load, written out anew."""
    envelope, path = declared_envelope(), circle(150.0, -0.35)
    v = float(speed_profile(path, envelope)[0])
    needed = v**2 / 150.0 - GRAVITY * np.sin(0.35)
    load = np.cos(0.35) + v**2 / 150.0 * np.sin(0.35) / GRAVITY
    assert needed == pytest.approx(envelope.lateral[0] * load, rel=0.02)
    assert load > 1.4


def test_less_trust_in_a_place_is_less_force_there() -> None:
    envelope = declared_envelope()
    full, less = (float(speed_profile(circle(60.0, trust=t), envelope)[0]) for t in (1.0, 0.81))
    assert less == pytest.approx(0.9 * full, rel=2e-3)


def test_downforce_of_the_model_widens_the_envelope_with_speed() -> None:
    from estimator.model.effects import catalogue

    effect = catalogue()["aero_downforce"]
    model = SingleTrack(load_car().vehicle, tyre_prior(load_car(), "per_axle"), (effect,))
    theta = [TYRE[p.name] for p in model.tyre_table]
    widened = envelope_of(model, theta, [0.3 * p.upper for p in effect.parameters], car=load_car())
    assert widened.lateral[1] > 1e-4
    assert widened.at(widened.lateral, np.array([60.0])) > declared_envelope().lateral[0] * 1.02

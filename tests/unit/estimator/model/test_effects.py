"""Every effect: nothing at its neutral value, the right sign, exact derivatives, mirror symmetry where it holds."""

from __future__ import annotations

import ast
import pickle
from collections.abc import Mapping
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from typer.testing import CliRunner

from estimator.model import memory
from estimator.model.effect import Effect
from estimator.model.effects import catalogue
from estimator.model.look_alikes import LOOK_ALIKES
from estimator.model.memory import after_play, axle_courses, delayed, held, relaxed, swung
from estimator.model.parameters import tyre_prior
from estimator.model.profile import profile_basis, profile_value
from estimator.model.single_track import CHANNELS, SIGNALS, SingleTrack, Terms
from hil_gateway.car.car import load_car
from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.process.compiled import find_compiler

ROOT = Path(__file__).resolve().parents[4]
VEHICLE = load_car().vehicle
AUXILIARY = {"brake": 0.3, "yaw": 0.4, "t": 100.0, "steer_rate": 0.3, "drive_rate": -0.2, "track_position": 250.0}
IDS = {
    "aero_drag", "rolling_resistance", "road_grade", "road_bank", "aero_downforce", "load_transfer",
    "load_sensitivity", "combined_slip", "drive_saturation", "front_brake", "engine_braking", "steer_offset",
    "steer_scale", "steer_delay", "drive_delay", "tyre_relaxation", "grip_drift", "imu_misalignment",
    "imu_lever_arm", "imu_bias", "speed_scale", "wind", "yaw_damping", "turn_asymmetry",
    "brake_pressure", "traction_loss", "traction_load", "total_slip", "gear_shift", "steer_play", "limited_slip",
    "steer_lag", "drive_lag",
}  # fmt: skip
MIRROR_BREAKING = {
    "steer_offset", "imu_misalignment", "imu_lever_arm", "imu_bias", "wind", "turn_asymmetry", "road_bank",
}  # fmt: skip
LEFT_TURN = {"vx": 38.0, "vy": -0.35, "yaw_rate": 0.33, "steer": 0.045, "drive": -0.04}
# effect -> (parameters, signals changed, channel, sign of the change)
SIGNS = {
    "aero_drag": ((0.5,), {}, "ax", -1),
    "rolling_resistance": ((400.0,), {}, "ax", -1),
    "road_grade": ((0.05,), {}, "vx_dot", -1),
    "road_bank": ((0.05,), {}, "vy_dot", -1),
    "aero_downforce": ((0.4, 0.4), {}, "ay", 1),
    "load_transfer": ((0.3,), {}, "yaw_acc", 1),
    "combined_slip": ((0.9,), {}, "ay", -1),
    "drive_saturation": ((3000.0,), {}, "ax", 1),
    "front_brake": ((0.5, 1.0), {}, "yaw_acc", -1),
    "engine_braking": ((400.0, 0.015), {}, "ax", -1),
    "steer_offset": ((0.01,), {}, "ay", 1),
    "steer_scale": ((1.1,), {}, "ay", 1),
    "steer_delay": ((0.05,), {}, "ay", -1),
    "steer_lag": ((0.05,), {}, "ay", -1),
    "drive_lag": ((0.05,), {}, "ax", 1),
    "drive_delay": ((0.05,), {}, "ax", 1),
    "grip_drift": ((-1e-3, 0.0), {}, "ay", -1),
    "imu_misalignment": ((0.02,), {}, "ax", 1),
    "imu_lever_arm": ((1.0, 0.0), {}, "ax", -1),
    "imu_bias": ((0.2, 0.1, 0.01), {}, "ay", 1),
    "speed_scale": ((1.05, 1.0), {}, "yaw_acc", -1),
    "wind": ((-8.0, 0.0, 0.5), {}, "ax", -1),
    "yaw_damping": ((500.0,), {}, "yaw_acc", -1),
    "turn_asymmetry": ((0.05,), {}, "ay", 1),
    "brake_pressure": ((5000.0,), {}, "ax", -1),
    "traction_loss": ((0.8,), {}, "ax", 1),
    "total_slip": ((0.3, 0.8, 0.0), {}, "ay", -1),
    "limited_slip": ((0.2, 0.017), {}, "yaw_acc", -1),
}


def predict(effect: Effect | None, parameters: tuple[float, ...] = (), **signals: float) -> dict[str, float]:
    model = SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle"), () if effect is None else (effect,))
    terms = Terms(VEHICLE, **{name: signals[name] for name in SIGNALS}, aux=AUXILIARY)
    model.evaluate(terms, [p.prior for p in model.tyre_table], parameters)
    return dict(zip(CHANNELS, (float(value) for value in terms.channels()), strict=True))


BESIDE = {"load_sensitivity": (("load_transfer", 0.3),), "traction_load": (("load_transfer", 0.3),)}
"""effects (with one parameter) without which another does not show: loads must move"""
VISIBLE = {"load_sensitivity": (0.3,), "traction_load": (1.0,), "limited_slip": (0.2, 0.017)}
"""a size that shows, where the start of a fit is the neutral value"""
PAST = {
    "tyre_relaxation": {"relaxation_f": -0.004, "relaxation_r": -0.003},
    "gear_shift": {"shifting": 1.0},
    "steer_play": {"steer_lost": -0.0015},
}
"""what an effect with memory makes of the past: in the middle of turning in; a gear changes"""


PULLING = {"gear_shift": {"drive": 0.04}}
"""what the car does where an effect does not show while braking"""


SHOWS: dict[str, tuple[dict[str, float], dict[str, float], tuple[float, ...]]] = {
    "ax_gain": ({}, {}, (1.05,)),
    "ay_gain": ({}, {}, (1.05,)),
    "brake_drag": ({"brake_held": 0.03}, {"drive": 0.01}, (0.3, 3.0, 1.0)),
    "drive_curve": ({}, {"drive": 0.01}, (0.3, 1.0)),
    "gyro_gain": ({}, {}, (1.03,)),
    "steer_swing": ({"steer_swing": 0.001}, {}, (0.2, 0.3)),
    "stiffness_drift": ({}, {}, (1e-3, 0.0)),
    "torque_steer": ({}, {}, (0.0, 0.02)),
    "torque_vectoring": ({}, {"drive": 0.04}, (0.2,)),
    "tyre_heat": ({"tyre_heat": 0.8}, {}, (-0.2, 60.0)),
}
"""look-alike -> what it makes of the past, what the car does, and a size that shows there"""


def predict_with(
    effects: tuple[Effect, ...], parameters: tuple[float, ...], past: Mapping[str, float], state: Mapping[str, float]
) -> dict[str, float]:
    model = SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle"), effects)
    terms = Terms(VEHICLE, **{**LEFT_TURN, **state}, aux={**AUXILIARY, **past})
    model.evaluate(terms, [p.prior for p in model.tyre_table], parameters)
    return dict(zip(CHANNELS, (float(value) for value in terms.channels()), strict=True))


def test_the_catalogue_holds_every_agreed_id() -> None:
    assert set(catalogue()) == IDS
    assert all(e.cause for e in catalogue().values())


def test_effects_can_be_sent_to_another_process() -> None:
    for effect in catalogue().values():
        assert pickle.loads(pickle.dumps(effect)).name == effect.name


@pytest.mark.parametrize("name", sorted(IDS))
def test_neutral_parameters_leave_the_declared_model_exactly(name: str) -> None:
    effect = catalogue()[name]
    declared = predict(None, **LEFT_TURN)
    changed = predict(effect, effect.neutral(), **LEFT_TURN)
    assert changed == pytest.approx(declared, rel=1e-7, abs=1e-7)


@pytest.mark.parametrize("name", sorted(LOOK_ALIKES))
def test_neutral_look_alikes_leave_the_declared_model_and_others_change_the_channels_they_declare(name: str) -> None:
    effect, declared = LOOK_ALIKES[name], predict(None, **LEFT_TURN)
    assert predict(effect, effect.neutral(), **LEFT_TURN) == pytest.approx(declared, rel=1e-7, abs=1e-7)
    past, state, parameters = SHOWS[name]
    before, after = predict_with((), (), {}, state), predict_with((effect,), parameters, past, state)
    moved = {channel for channel in CHANNELS if abs(after[channel] - before[channel]) > 2e-2}
    assert moved == set(effect.channels)


@pytest.mark.parametrize("name", sorted(SIGNS))
def test_sign_of_the_effect(name: str) -> None:
    parameters, signals, channel, sign = SIGNS[name]
    state = LEFT_TURN | signals
    change = predict(catalogue()[name], parameters, **state)[channel] - predict(None, **state)[channel]
    assert change * sign > 1e-3, f"{name}: {channel} changes by {change}"


@pytest.mark.parametrize("name", sorted(IDS))
def test_declared_channels_are_those_that_change(name: str) -> None:
    effect = catalogue()[name]
    parameters = SIGNS.get(name, (VISIBLE.get(name, effect.start()),))[0]
    given = BESIDE.get(name, ())
    state = PULLING.get(name, {})
    before = predict_with(tuple(catalogue()[n] for n, _ in given), tuple(v for _, v in given), {}, state)
    beside = (*(catalogue()[n] for n, _ in given), effect)
    after = predict_with(beside, (*(v for _, v in given), *parameters), PAST.get(name, {}), state)
    moved = {channel for channel in CHANNELS if abs(after[channel] - before[channel]) > 2e-2}
    assert set(effect.channels) & moved, f"{name} moves {moved}"


@pytest.mark.parametrize("name", sorted(IDS - MIRROR_BREAKING))
def test_mirrored_state_gives_mirrored_accelerations(name: str) -> None:
    effect = catalogue()[name]
    parameters = SIGNS.get(name, (effect.start(),))[0]
    left = {**LEFT_TURN}
    right = {**left, "vy": -left["vy"], "yaw_rate": -left["yaw_rate"], "steer": -left["steer"]}
    mirrored = {key: -value if key == "steer_rate" else value for key, value in AUXILIARY.items()}
    a = predict(effect, parameters, **left)
    terms = Terms(VEHICLE, **{n: right[n] for n in SIGNALS}, aux=mirrored)
    model = SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle"), (effect,))
    model.evaluate(terms, [p.prior for p in model.tyre_table], parameters)
    b = dict(zip(CHANNELS, (float(v) for v in terms.channels()), strict=True))
    odd = {"ay", "yaw_acc", "vy_dot"}
    assert b == pytest.approx({c: -v if c in odd else v for c, v in a.items()}, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("name", sorted(IDS))
def test_jacobian_agrees_with_finite_differences(name: str) -> None:
    effect = catalogue()[name]
    loads = (catalogue()["load_transfer"],) if effect.requires_any else ()
    model = SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle"), (*loads, effect))
    size = len(model.effect_table)
    phi, state = ca.SX.sym("phi", size), ca.SX.sym("state", 5)
    terms = Terms(VEHICLE, *ca.vertsplit(state), aux=AUXILIARY)
    out = ca.vertcat(*model.evaluate(terms, [p.prior for p in model.tyre_table], ca.vertsplit(phi)).channels())
    f = ca.Function("f", [state, phi], [out])
    jacobian = ca.Function("j", [state, phi], [ca.jacobian(out, phi)])
    rng = np.random.default_rng(7)
    for _ in range(20):
        x = np.array([*LEFT_TURN.values()]) * rng.uniform(0.7, 1.3, 5)
        at = np.array([*([0.3] * len(loads)), *SIGNS.get(name, (effect.start(),))[0]])
        exact = np.array(jacobian(x, at))
        step = 1e-6 * np.maximum(np.abs(at), 1e-2)
        for k in range(size):
            d = np.eye(size)[k] * step[k]
            numeric = (np.array(f(x, at + d)) - np.array(f(x, at - d))).ravel() / (2 * step[k])
            np.testing.assert_allclose(exact[:, k], numeric, rtol=1e-5, atol=1e-6 * (1 + np.abs(numeric).max()))


def test_gravity_is_not_felt_by_the_accelerometer() -> None:
    for name, channel in (("road_grade", "vx_dot"), ("road_bank", "vy_dot")):
        before, after = predict(None, **LEFT_TURN), predict(catalogue()[name], (0.1,), **LEFT_TURN)
        assert after[channel] - before[channel] == pytest.approx(-GRAVITY * np.sin(0.1))
        assert after["ax"] == before["ax"]
        assert after["ay"] == before["ay"]


def test_load_transfer_moves_load_and_keeps_its_sum() -> None:
    model = SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle"), (catalogue()["load_transfer"],))
    terms = Terms(VEHICLE, **LEFT_TURN)
    model.evaluate(terms, [p.prior for p in model.tyre_table], (0.3,))
    assert terms.load_f + terms.load_r == pytest.approx(VEHICLE.mass * GRAVITY)
    assert terms.load_f > VEHICLE.static_load_front, "braking loads the front axle"


def test_delay_and_relaxation_follow_their_definitions() -> None:
    t = np.arange(0.0, 4.0, 0.01)
    wave = np.sin(2 * t)
    np.testing.assert_allclose(delayed(t, wave, 0.05)[10:], np.sin(2 * (t - 0.05))[10:], atol=1e-4)
    tau = 0.2
    expected = (np.sin(2 * t) - 2 * tau * np.cos(2 * t) + 2 * tau * np.exp(-t / tau)) / (1 + 4 * tau**2)
    np.testing.assert_allclose(relaxed(t, wave, np.full(len(t), tau)), expected, atol=2e-4)


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler: there is nothing to compare")
def test_the_compiled_lag_is_that_of_the_scan(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, t = np.random.default_rng(4), np.arange(500) * 0.01
    signals, lag = rng.normal(size=(2, 500)), rng.uniform(0.0, 0.3, 500)
    compiled = relaxed(t, signals, lag)
    monkeypatch.setattr(memory, "_library", lambda: None)
    np.testing.assert_allclose(compiled, relaxed(t, signals, lag), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(compiled[1], relaxed(t, signals[1], lag), rtol=1e-9, atol=1e-12)


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler: there is nothing to compare")
def test_the_compiled_swing_is_that_of_the_scan(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    t, signal = np.cumsum(rng.uniform(0.005, 0.02, 500)), rng.normal(size=500)
    compiled = swung(t, signal, 0.25, 0.2)
    monkeypatch.setattr(memory, "_library", lambda: None)
    np.testing.assert_allclose(compiled, swung(t, signal, 0.25, 0.2), rtol=1e-9, atol=1e-12)


def test_slip_angles_that_grow_evenly_lag_by_the_length_over_the_speed() -> None:
    """Each axle's own course and the steering count: on a ramp, a first-order lag is late by its time constant."""
    effect, speed, length, a, b = catalogue()["tyre_relaxation"], 40.0, 0.8, 0.03, -0.05
    t = np.arange(0.0, 4.0, 0.01)
    signals = {"t": t, "vx": np.full(len(t), speed), "vy": 0.2 * speed * a * t, "yaw_rate": 0.0 * t, "steer": b * t}
    assert effect.prepare is not None
    lag = effect.prepare({**signals, **axle_courses(signals, VEHICLE)}, VEHICLE, (length,))
    late = -length / speed * np.array([b - 0.2 * a, -0.2 * a])
    found = [lag["relaxation_f"][-1], lag["relaxation_r"][-1]]
    np.testing.assert_allclose(found, late, rtol=2e-3)
    turning = axle_courses({**signals, "vy": 0.0 * t, "yaw_rate": 0.1 + 0.0 * t}, VEHICLE)
    assert turning["course_f"][0] == pytest.approx(0.1 * VEHICLE.lf / speed, rel=1e-3)
    assert turning["course_r"][0] == pytest.approx(-0.1 * VEHICLE.lr / speed, rel=1e-3)


def test_wheels_that_swing_follow_a_step_as_a_damped_oscillator() -> None:
    t, period, damping = np.arange(0.0, 2.0, 0.01), 0.25, 0.2
    step = np.where(t > 0.495, 1.0, 0.0)
    w, root, since = 2 * np.pi / period, np.sqrt(1 - damping**2), t - 0.495
    ringing = np.exp(-damping * w * since) * (np.cos(w * root * since) + damping / root * np.sin(w * root * since))
    np.testing.assert_allclose(swung(t, step, period, damping), np.where(since > 0, 1.0 - ringing, 0.0), atol=0.01)
    np.testing.assert_array_equal(swung(t, step, 0.0, damping), step)


def test_a_brake_that_lets_go_slowly_holds_the_most_it_was_pressed() -> None:
    t, time_constant = np.cumsum(np.full(400, 0.05)), 3.0
    pressed = np.maximum(np.sin(0.9 * t), 0.0) * np.where(t < 10.0, 1.0, 0.3)
    keeps, followed = pressed[0], np.empty_like(t)
    for i, now in enumerate(pressed):
        keeps = max(now, keeps * np.exp(-0.05 / time_constant))
        followed[i] = keeps
    np.testing.assert_allclose(held(t, pressed, time_constant), followed, rtol=1e-9, atol=1e-12)


def test_wheels_with_play_follow_the_angle_one_sample_after_the_other() -> None:
    rng = np.random.default_rng(4)
    angle, gap = np.cumsum(rng.normal(0.0, 0.3e-3, 5000)), 0.006
    wheels, followed = angle[0], np.empty_like(angle)
    for i, asked in enumerate(angle):
        wheels = min(max(wheels, asked - gap / 2), asked + gap / 2)
        followed[i] = wheels
    np.testing.assert_allclose(after_play(angle, gap), followed, rtol=0, atol=1e-15)
    assert 0.2 * gap < np.abs(followed - angle).mean() < 0.5 * gap
    np.testing.assert_array_equal(after_play(angle, 0.0), angle)


def test_profile_is_periodic_and_the_same_in_numbers_and_symbols() -> None:
    rng = np.random.default_rng(3)
    coefficients = rng.normal(size=12)
    s = rng.uniform(-500.0, 4500.0, 50)
    numbers = profile_basis(s, 1700.0, 12) @ coefficients
    position = ca.SX.sym("s")
    symbolic = ca.Function("p", [position], [profile_value(position, 1700.0, list(coefficients))])
    np.testing.assert_allclose(numbers, [float(symbolic(v)) for v in s], atol=1e-12)
    np.testing.assert_allclose(numbers, profile_basis(s + 1700.0, 1700.0, 12) @ coefficients, atol=1e-12)
    np.testing.assert_allclose(profile_basis(s, 1700.0, 12).sum(axis=1), 1.0, atol=1e-12)


def test_a_limited_slip_axle_is_locked_below_what_its_clutches_bear_and_slips_beyond() -> None:
    effect, inertia = catalogue()["limited_slip"], VEHICLE.yaw_inertia
    lever, compliance, omega = 0.2, 0.017, 0.3

    def moment(vx: float, drive: float, compliance: float = compliance) -> float:
        state = LEFT_TURN | {"vx": vx, "yaw_rate": omega, "drive": drive}
        with_it, without = predict(effect, (lever, compliance), **state), predict(None, **state)
        return (without["yaw_acc"] - with_it["yaw_acc"]) * inertia

    force = 0.04 * next(
        p.prior for p in SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")).tyre_table if p.name == "cx"
    )
    borne = pytest.approx(lever * np.hypot(force, 1e3), rel=0.1)
    assert moment(80.0, 0.15) == pytest.approx(1e3 * omega / compliance / 80.0, rel=0.03)
    assert moment(5.0, 0.04) == pytest.approx(moment(5.0, -0.04)) == borne
    assert moment(80.0, 0.04, 0.0) == borne, "without compliance its clutches slip in every bend"


def test_no_module_knows_an_effect_by_its_name() -> None:
    """What is special about an effect is a field of it: one more is one more file."""
    catalogue_folder = ROOT / "estimator" / "model" / "effects"
    files = [file for package in ("estimator", "planner") for file in (ROOT / package).rglob("*.py")]
    outside = [file for file in files if catalogue_folder not in file.parents]
    assert len(outside) > 100
    named = {
        f"{file.relative_to(ROOT)}:{node.lineno}: {node.value}"
        for file in outside
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.Constant) and node.value in IDS
    }
    assert named == set()


def test_diagnose_prints_every_equation_and_parameter_with_its_range_and_reason() -> None:
    from estimator.cli.diagnose import app

    printed = CliRunner().invoke(app, ["--effects"])
    assert printed.exit_code == 0
    for effect in catalogue().values():
        block = printed.stdout.split(f"\n{effect.name}: {effect.lacks}")[1]
        assert block.splitlines()[1].strip() == effect.equation
        lines = block.splitlines()[2 : 2 + len(effect.parameters)]
        for line, p in zip(lines, effect.parameters, strict=True):
            assert p.plausible is not None, f"{effect.name}.{p.name}"
            assert p.lower <= p.plausible.lower < p.plausible.upper <= p.upper
            assert line.startswith(f"  {p.name}")
            assert f"{p.plausible.lower:g} to {p.plausible.upper:g}" in line
            assert p.plausible.reason in line


def test_engine_braking_switches_sample_by_sample_and_by_the_throttle_where_it_is_recorded() -> None:
    prepare = catalogue()["engine_braking"].prepare
    assert prepare is not None
    fluttering = {"drive": np.array([0.004, -0.003, 0.004, -0.003])}
    np.testing.assert_array_equal(prepare(fluttering, VEHICLE, (300.0, 0.02))["throttle_closed"], [0, 1, 0, 1])
    pedal = fluttering | {"throttle": np.array([0.0, 0.0, 0.3, 0.3])}
    np.testing.assert_allclose(prepare(pedal, VEHICLE, (300.0, 0.02))["throttle_closed"], [1, 1, 0, 0], atol=1e-3)


def test_a_biased_gyroscope_is_told_from_the_turning_of_the_car() -> None:
    effect, biased = catalogue()["imu_bias"], LEFT_TURN | {"yaw_rate": LEFT_TURN["yaw_rate"] + 0.02}
    assert predict(effect, (0.0, 0.0, 0.02), **biased) == pytest.approx(predict(None, **LEFT_TURN), rel=1e-12)


def test_drive_is_missing_for_the_gap_after_a_change_of_gear_and_at_no_other_time() -> None:
    effect = catalogue()["gear_shift"]
    assert effect.prepare is not None
    signals = {"t": np.arange(8) * 0.01, "gear": np.array([2.0, 2.0, 3.0, 3.0, 3.0, 3.0, 3.0, 3.0])}
    shifting = effect.prepare(signals, VEHICLE, (0.035,))["shifting"]
    np.testing.assert_allclose(shifting, [0, 0, 1, 1, 1, 0.5, 0, 0], atol=1e-9)
    for drive, force_left in ((0.05, 0.0), (-0.05, -0.05)):
        state = LEFT_TURN | {"drive": drive}
        none, gap = (predict_with((effect,), (0.035,), {"shifting": s}, state)["ax"] for s in (0.0, 1.0))
        cx = SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle")).tyre_table[0].prior
        assert gap - none == pytest.approx(cx * (force_left - drive) / VEHICLE.mass, abs=0.03)


def test_axles_share_the_braking_force_as_their_pressures_times_what_each_makes_of_it() -> None:
    """Front 4 MPa and rear 2 MPa on a car whose front brakes do 0.6 at equal pressures."""
    front, rear = 4.0 * 0.6, 2.0 * 0.4
    terms = Terms(VEHICLE, 40.0, 0.0, 0.0, 0.0, -0.2, aux={"brake_balance": (4.0 - 2.0) / (4.0 + 2.0)})
    model = SingleTrack(VEHICLE, tyre_prior(load_car(), "per_axle"), (catalogue()["front_brake"],))
    model.evaluate(terms, [p.prior for p in model.tyre_table], (0.6, 1.1))
    total = 1.1 * 0.2 * 50_000.0
    assert [float(terms.fx_f), float(terms.fx_r)] == pytest.approx(
        [-total * front / (front + rear), -total * rear / (front + rear)], rel=5e-3
    )

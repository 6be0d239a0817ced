"""Physics of the simulated car: conservation, balance, symmetry, order of integration, known limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil_gateway.car.vehicle import GRAVITY
from hil_gateway.plant.physics.dynamics import INPUTS, OUTPUTS, STATES, rates_function, step_function
from hil_gateway.plant.physics.parameters import AV24, PAPER, CarParameters, PlantParameters

CAR = AV24.car
Values = dict[str, float]
RESTING = {"gravity_z": GRAVITY, "grip": 1.0, "engine_running": 1.0}


def _state(car: CarParameters = CAR, **values: float) -> np.ndarray:
    x = np.zeros(len(STATES))
    for name, value in {
        f"spin_{w}": values.get("vx", 0.0) / car.wheel_radius for w in ("fl", "fr", "rl", "rr")
    }.items():
        x[STATES.index(name)] = value
    for name, value in values.items():
        x[STATES.index(name)] = value
    return x


def _input(**values: float) -> np.ndarray:
    return np.array([{**RESTING, **values}.get(name, 0.0) for name in INPUTS])


def _rates(x: np.ndarray, u: np.ndarray, car: CarParameters = CAR) -> tuple[Values, Values]:
    rates, outputs = rates_function()(x, u, car.vector())
    return (
        dict(zip(STATES, np.array(rates).ravel(), strict=True)),
        dict(zip(OUTPUTS, np.array(outputs).ravel(), strict=True)),
    )


def _run(
    x: np.ndarray, u: np.ndarray, seconds: float, h: float = 1e-3, car: CarParameters = CAR
) -> tuple[np.ndarray, Values]:
    f, p = step_function(), car.vector()
    outputs = None
    for _ in range(round(seconds / h)):
        x, outputs = f(x, u, p, h)
    return np.array(x).ravel(), dict(zip(OUTPUTS, np.array(outputs).ravel(), strict=True))


def _steady_turn(steer: float, speed: float, car: CarParameters = CAR) -> tuple[Values, Values]:
    """Settle in a turn at about constant speed (throttle by a slow integral)."""
    x, throttle = _state(car, vx=speed), 0.2
    gear = 1.381 * 3.0
    for _ in range(60):
        throttle = float(np.clip(throttle + 0.04 * (speed - x[STATES.index("vx")]), 0.0, 1.0))
        x, outputs = _run(x, _input(steer_command=steer, throttle_command=throttle, ratio=gear), 0.1, 2e-3, car)
    return dict(zip(STATES, x, strict=True)), outputs


def test_wheel_loads_carry_weight_and_downforce() -> None:
    for ax, ay, speed in ((0.0, 0.0, 0.0), (5.0, 0.0, 40.0), (-9.0, 12.0, 60.0)):
        _, out = _rates(_state(vx=speed, load_ax=ax, load_ay=ay), _input())
        total = sum(out[f"load_{w}"] for w in ("fl", "fr", "rl", "rr"))
        expected = CAR.mass * GRAVITY + CAR.downforce * speed**2
        assert total == pytest.approx(expected, rel=2e-3)


def test_accelerometer_feels_the_road_and_not_the_downforce() -> None:
    """Air presses down as much as it loads the tyres: the sum is the weight."""
    for speed, gravity in ((0.0, GRAVITY), (80.0, GRAVITY), (80.0, 1.6 * GRAVITY)):
        _, out = _rates(_state(vx=speed), _input(gravity_z=gravity))
        assert out["az"] == pytest.approx(gravity, rel=2e-3)


def test_load_moves_by_acceleration_times_height() -> None:
    _, still = _rates(_state(), _input())
    _, braking = _rates(_state(load_ax=-8.0), _input())
    _, turning = _rates(_state(load_ay=8.0), _input())
    front = sum(braking[f"load_{w}"] - still[f"load_{w}"] for w in ("fl", "fr"))
    assert front == pytest.approx(CAR.mass * 8.0 * CAR.cg_height / CAR.wheelbase, rel=1e-3)
    moment = sum(
        0.5 * track * (turning[f"load_{right}"] - turning[f"load_{left}"])
        for track, left, right in ((CAR.track_front, "fl", "fr"), (CAR.track_rear, "rl", "rr"))
    )
    assert moment == pytest.approx(CAR.mass * 8.0 * CAR.cg_height, rel=2e-3)


def test_steady_turn_balances_forces_and_moments() -> None:
    state, out = _steady_turn(0.04, 30.0)
    assert out["ay"] == pytest.approx(state["vx"] * state["yaw_rate"], rel=0.01)
    assert out["yaw_acc"] == pytest.approx(0.0, abs=0.02)
    front, rear = out["force_y_front"], out["force_y_rear"]
    assert front * CAR.lf * np.cos(0.04) == pytest.approx(rear * CAR.lr, rel=0.06)  # the differential takes the rest
    assert 5.0 < out["ay"] < 15.0


def test_slow_turn_follows_the_geometry() -> None:
    state, _ = _steady_turn(0.08, 5.0)
    assert state["yaw_rate"] / state["vx"] == pytest.approx(np.tan(0.08) / CAR.wheelbase, rel=0.06)


def test_realistic_car_understeers_at_speed() -> None:
    slow, _ = _steady_turn(0.02, 15.0)
    fast, _ = _steady_turn(0.02, 45.0)
    assert fast["yaw_rate"] / fast["vx"] < 0.97 * slow["yaw_rate"] / slow["vx"]


def test_top_speed_is_where_power_meets_drag() -> None:
    car = replace(CAR, engine_drag=0.0)
    x, out = _run(_state(vx=80.0), _input(throttle_command=1.0, ratio=0.889 * 3.0), 60.0, 5e-3, car)
    speed = x[STATES.index("vx")]
    resistance = car.drag * speed**2 + car.rolling_resistance
    assert out["axle_torque"] / car.wheel_radius == pytest.approx(resistance, rel=0.01)
    assert 75.0 < speed < 92.0


def test_coasting_follows_the_drag_law() -> None:
    car = replace(PAPER.car, drag=0.6)
    mass = car.mass + 4.0 * car.wheel_inertia / car.wheel_radius**2  # the wheels slow down too
    x, _ = _run(_state(vx=60.0), _input(), 5.0, 1e-3, car)
    assert x[STATES.index("vx")] == pytest.approx(60.0 / (1.0 + 0.6 * 60.0 * 5.0 / mass), rel=1e-3)


def _energy(x: np.ndarray, car: CarParameters) -> float:
    v = dict(zip(STATES, x, strict=True))
    spins = sum(v[f"spin_{w}"] ** 2 for w in ("fl", "fr", "rl", "rr"))
    kinetic = 0.5 * car.mass * (v["vx"] ** 2 + v["vy"] ** 2) + 0.5 * car.yaw_inertia * v["yaw_rate"] ** 2
    return kinetic + 0.5 * car.wheel_inertia * spins


def test_engine_work_is_kinetic_energy_plus_losses() -> None:
    car = replace(CAR, engine_inertia=0.0)
    u = _input(steer_command=0.05, throttle_command=0.6, brake_rear_command=2e5, ratio=1.875 * 3.0)
    x, h, work, lost = _state(car, vx=25.0, vy=0.3), 1e-3, 0.0, 0.0
    before = _energy(x, car)
    for _ in range(2000):
        middle, _ = _run(x, u, h / 2, h / 2, car)
        _, out = _rates(middle, u, car)
        axle = 0.5 * (middle[STATES.index("spin_rl")] + middle[STATES.index("spin_rr")])
        work += out["axle_torque"] * axle * h
        lost += out["power_loss"] * h
        x, _ = _run(x, u, h, h, car)
    assert _energy(x, car) - before == pytest.approx(work - lost, rel=1e-3)
    assert lost > 0


@settings(max_examples=50, deadline=None)
@given(
    vx=st.floats(0.0, 85.0), vy=st.floats(-8.0, 8.0), rate=st.floats(-1.5, 1.5), steer=st.floats(-0.27, 0.27),
    slip=st.floats(-0.2, 0.2), throttle=st.floats(0.0, 1.0), ay=st.floats(-20.0, 20.0),
)  # fmt: skip
def test_mirror_image_of_the_car_moves_as_a_mirror_image(
    *, vx: float, vy: float, rate: float, steer: float, slip: float, throttle: float, ay: float
) -> None:
    spin = vx / CAR.wheel_radius

    def motion(sign: float) -> Values:
        left, right = ("l", "r") if sign > 0 else ("r", "l")
        x = _state(
            vx=vx, vy=sign * vy, yaw_rate=sign * rate, steer=sign * steer, throttle=throttle, load_ay=sign * ay,
            **{f"spin_r{left}": spin * 1.1, f"spin_r{right}": spin * 0.95},
            **{f"slip_x_f{left}": slip, f"slip_x_r{right}": slip / 2},
            **{f"slip_y_f{left}": sign * slip, f"slip_y_r{right}": -sign * slip / 3},
        )  # fmt: skip
        rates, _ = _rates(x, _input(ratio=5.0))
        return rates

    here, there = motion(1.0), motion(-1.0)
    assert here["vx"] == pytest.approx(there["vx"], abs=1e-9)
    for name in ("vy", "yaw_rate", "steer"):
        assert here[name] == pytest.approx(-there[name], abs=1e-9)
    assert here["spin_rl"] == pytest.approx(there["spin_rr"], abs=1e-6)
    assert here["slip_y_fr"] == pytest.approx(-there["slip_y_fl"], abs=1e-9)


def test_runge_kutta_converges_at_order_four() -> None:
    x = _state(vx=30.0, vy=0.1, steer=0.02, throttle=0.3)
    u = _input(steer_command=0.03, throttle_command=0.4, ratio=1.381 * 3.0)
    exact, _ = _run(x, u, 0.08, 1e-4)
    errors = [np.abs(_run(x, u, 0.08, h)[0] - exact)[:10].max() for h in (4e-3, 2e-3)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.5)


@pytest.mark.parametrize("parameters", [AV24, PAPER], ids=["av24", "paper"])
def test_parked_car_stays_parked(parameters: PlantParameters) -> None:
    u = _input(brake_front_command=1e6, brake_rear_command=1e6)
    x, _ = _run(_state(vx=0.5, vy=0.05), u, 5.0, 1e-3, parameters.car)
    assert np.isfinite(x).all()
    assert np.abs(x[3:6]).max() < 1e-5


def test_full_braking_stops_without_reversing() -> None:
    x, _ = _run(_state(vx=60.0), _input(brake_front_command=4e6, brake_rear_command=3e6), 8.0)
    assert abs(x[STATES.index("vx")]) < 0.05


def test_paper_base_reduces_to_the_single_track_equations() -> None:
    """With everything off, the four wheels give Eq. (1)-(3), written out here by hand."""
    car = PAPER.car
    state, out = _steady_turn(0.03, 35.0, car)
    vx, vy, r = state["vx"], state["vy"], state["yaw_rate"]
    front = 0.03 - np.arctan((vy + car.lf * r) / vx)
    rear = -np.arctan((vy - car.lr * r) / vx)
    fy_front = car.df * car.static_load_front * np.sin(car.cf * np.arctan(car.bf * front))
    fy_rear = car.dr * car.static_load_rear * np.sin(car.cr * np.arctan(car.br * rear))
    assert out["force_y_front"] == pytest.approx(fy_front, rel=5e-3)
    assert out["force_y_rear"] == pytest.approx(fy_rear, rel=5e-3)
    assert out["ay"] == pytest.approx((fy_rear + fy_front * np.cos(0.03)) / car.mass, rel=5e-3)

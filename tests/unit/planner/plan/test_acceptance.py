"""Acceptance: every kind of broken plan is refused by code that does not know the solver."""

from __future__ import annotations

import itertools
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from benchmarks.plans.bench import bench_controller, clock, start_state
from estimator.belief.revision import declared_revision, model_of, race_car_revision, starting_revision
from estimator.model.parameters import tyre_prior
from estimator.model.single_track import SIGNALS, SingleTrack, Terms
from estimator.model.tyre import front_and_rear
from hil_gateway.bus.delivered import Delivered
from hil_gateway.car.car import load_car
from hil_gateway.config import load_config
from hil_gateway.track.loading import load_track
from planner.adoption.adoption import Adoption
from planner.line.track import Reference
from planner.plan import acceptance
from planner.plan.acceptance import AcceptanceCheck, Bounds, CheckedPlan
from planner.plan.checks import PlanCheck, Roadside, bounds_of, plan_of
from planner.plan.controller import Controller
from planner.problem.brake_law import BrakeLaw
from planner.problem.checked_motion import COLUMNS, FORCES, CheckedMotion
from planner.problem.load_limits import LoadLimits
from planner.problem.load_rows import load_row
from planner.problem.motion import NZ, extra_load
from planner.problem.mpcc import Problem
from planner.problem.settings import declared_settings, settings_of
from planner.solver.sqp import Solution


@pytest.fixture(scope="module")
def solved() -> tuple[Controller, Solution]:
    controller, _ = bench_controller(load_track(), load_car().vehicle, declared_settings(load_car()))
    return controller, controller.cold_start(start_state(controller, 620.0), clock)


Case = tuple[CheckedPlan, Bounds, AcceptanceCheck]


@pytest.fixture
def case(solved: tuple[Controller, Solution]) -> Case:
    controller, solution = solved
    check = AcceptanceCheck(controller.checked, controller.knowledge.theta, np.zeros(0), 1.0)
    bounds = replace(bounds_of(controller.settings, controller.knowledge.load_max, 0.0), information=100.0)
    return plan_of(solution, Roadside(controller.reference.line)), bounds, check


def violations(plan: CheckedPlan, bounds: Bounds, check: AcceptanceCheck) -> list[str]:
    return acceptance.violations(check(plan, bounds), bounds)


def test_a_solution_is_accepted(case: Case) -> None:
    assert violations(*case) == []


@pytest.mark.promise("N4")
@pytest.mark.parametrize(
    ("name", "value", "at", "broken"),
    [
        ("offset", 9.0, 25, "track"),
        ("offset", -14.0, 25, "track"),
        ("vy", 6.0, 25, "load"),
        ("yaw_rate", 2.5, 25, "load"),
        ("steer", 0.27, 25, "actuator"),
        ("drive", -0.37, 25, "actuator"),
        ("steer", 0.05, 25, "rate"),
        ("drive", -0.3, 25, "rate"),
        ("vx", -2.0, 25, "state"),
        ("vx", 90.0, 25, "state"),
        ("information", 120.0, 25, "information"),
        ("x", np.nan, 25, "not finite"),
        ("drive", np.inf, 3, "not finite"),
    ],
)
def test_one_bad_entry_is_enough(case: Case, name: str, value: float, at: int, broken: str) -> None:
    plan, bounds, check = case
    column = plan[name].copy()
    column[at] = value
    assert any(found.startswith(broken) for found in violations(plan.changed(**{name: column}), bounds, check))


def test_a_slide_is_refused_however_little_force_it_gives(
    case: Case,
) -> None:
    """Beyond the peak Eq. (2) gives less and less force, so force alone would call a spin harmless."""
    plan, bounds, check = case
    shares = []
    for sideways in (6.0, 12.0, 18.0):
        slid = plan.changed(vy=np.full_like(plan["vy"], sideways))
        shares.append(np.array([share[25] for share in check(slid, bounds).shares]))
        slid = plan.changed(vy=np.where(np.arange(len(plan["vy"])) == 25, sideways, plan["vy"]))
        assert any(found.startswith("load") for found in violations(slid, bounds, check))
    assert np.all(np.diff(shares, axis=0) > 0.0)


@pytest.mark.parametrize("name", ["x", "y", "yaw", "vx", "vy", "yaw_rate"])
def test_a_plan_that_no_car_can_follow_is_refused(case: Case, name: str) -> None:
    plan, bounds, check = case
    column = plan[name].copy()
    column[20:] += {"yaw": 0.1, "yaw_rate": 0.2}.get(name, 1.0)
    moved = plan.changed(**{name: column})
    found = violations(moved, bounds, check)
    assert any(f.startswith("dynamics") for f in found)


def test_recovery_from_beyond_a_limit_must_lead_back(case: Case) -> None:
    plan, bounds, check = case
    edge = plan["width_left"] - bounds.clearance
    back = edge + np.maximum(0.0, 0.5 - 0.05 * np.arange(len(edge)))
    assert violations(plan.changed(offset=back), bounds, check) == []
    stays = edge + 0.5
    assert any(f.startswith("track") for f in violations(plan.changed(offset=stays), bounds, check))


def test_offset_is_measured_from_the_race_line(solved: tuple[Controller, Solution]) -> None:
    line = solved[0].reference.line
    index = np.arange(100, 140)
    x = line.x[index] - 2.0 * np.sin(line.heading[index])
    y = line.y[index] + 2.0 * np.cos(line.heading[index])
    z = np.zeros((NZ, len(index)))
    z[0], z[1], z[6] = x, y, line.s[index]
    plan = plan_of(replace(solved[1], z=z, information=np.zeros(len(index) - 1)), Roadside(line))
    np.testing.assert_allclose(plan["offset"], 2.0, atol=1e-9)
    np.testing.assert_allclose(plan["width_left"], line.width_left[index], atol=1e-9)
    np.testing.assert_allclose(plan["width_right"], line.width_right[index], atol=1e-9)


def forces_of(
    model: SingleTrack, theta: np.ndarray, phi: np.ndarray, motion: np.ndarray, brake_ratio: float = 1.0
) -> dict[str, np.ndarray]:
    """`FORCES` as acceptance has them, (K,) each, at motions (6, K): `SIGNALS` and what the road adds."""
    names = (*SIGNALS, "extra_load")
    at, t, p = ca.SX.sym("at", len(names)), ca.SX.sym("t", len(theta)), ca.SX.sym("p", len(phi))
    checked = CheckedMotion(model, literal_load=False, brakes=BrakeLaw(load_car().vehicle, load_car().powertrain))
    felt = checked.forces(dict(zip(names, ca.vertsplit(at), strict=True)), t, p, brake_ratio)
    values = ca.Function("felt", [at, t, p], [ca.vertcat(*(felt[name] for name in FORCES))])(motion, theta, phi)
    return dict(zip(FORCES, np.array(values), strict=True))


def model_forces(model: SingleTrack, theta: np.ndarray, motion: np.ndarray) -> dict[str, np.ndarray]:
    """The same by the equations of the solver."""
    signals = [ca.DM(row).T for row in motion]
    terms = Terms(model.vehicle, **dict(zip(SIGNALS, signals, strict=False)), aux={"extra_load": signals[5]})
    terms = model.evaluate(terms, theta.tolist())
    found = {name: np.array(getattr(terms, name)).ravel() * np.ones(motion.shape[1]) for name in FORCES[:-2]}
    for axle, rows in zip(front_and_rear(model.layout), ("f", "r"), strict=True):
        b, c, _ = theta[list(axle.rows([p.name for p in model.tyre_table]))]
        phase = c * np.arctan(b * np.array(getattr(terms, f"slip_{rows}")).ravel())
        found[f"beyond_{rows}"] = np.maximum(np.abs(phase) - np.pi / 2, 0.0)
    return found


def test_forces_agree_with_the_model_of_the_solver() -> None:
    """Written twice, for the solver and for acceptance: the same physics, on crests and in dips too."""
    revised = model_of(declared_revision(tyre_prior(load_car(), "per_axle")), load_car().vehicle, 1000.0)
    motion = some_motion(200)
    a = forces_of(revised.model, revised.theta, np.zeros(0), motion)
    b = model_forces(revised.model, revised.theta, motion)
    for name in FORCES:
        atol = 1e-4 if "beyond" in name else 2.0
        np.testing.assert_allclose(a[name], b[name], rtol=1e-4, atol=atol)
    assert np.max(a["beyond_f"]) > 0.05, "some slide"


def some_motion(n: int) -> np.ndarray:
    """vx, vy, yaw rate, steer, drive, extra load."""
    rng = np.random.default_rng(0)
    low, high = np.array([[15.0, -4.0, -0.6, -0.2, -0.3, -0.5], [70.0, 4.0, 0.6, 0.2, 0.1, 0.8]])
    return np.asarray(rng.uniform(low[:, None], high[:, None], (6, n)))


def test_the_rows_of_the_race_car_are_the_forces_of_its_axles_over_their_peaks() -> None:
    """What braking and driving take from the lateral force is not counted as used; the declared combined slip of 0.8
    takes a tenth off a braking force, and nothing from half of the lateral peak on. A braking force counts for more by
    what is in doubt of the brakes, a driving one does not."""
    revised = model_of(race_car_revision(load_car(), "per_axle"), load_car().vehicle, 1000.0)
    problem, theta = Problem(revised.model, declared_settings(load_car())), ca.DM(revised.theta)
    p = {"theta": theta, "phi": ca.DM(revised.constants), "lap": 1000.0, "road_load": [0, 0, 0], "load_max": [1, 1]}
    p["brake_ratio"], p["brake_doubt"] = 1.2, ca.DM([1.1, 1.2])
    z = ca.SX.sym("z", NZ)
    terms = problem.evaluate(z, theta, p)
    along, across = (
        ca.vertcat(*(getattr(terms, f"{force}_{a}") / getattr(terms, f"peak_{a}") for a in "fr"))
        for force in ("fx", "fy")
    )
    taken_off = 0.1 * (along < 0.0) * (1.0 - ca.fmin((2.0 * across) ** 2, 1.0))
    counted_for_doubt = 1.0 + (p["brake_doubt"] - 1.0) * (along < 0.0)
    shares = ca.hypot(counted_for_doubt * (1.0 - taken_off) * along, across)
    rows = ca.vertcat(*(load_row(problem, a, z, theta, p).value for a in "fr"))
    compare = ca.Function("compare", [z], [rows, shares])
    for steer, drive in itertools.product((0.0, 0.02, 0.035), (-0.3, -0.15, 0.0, 0.12)):
        row, share = compare([0, 0, 0, 50.0, -40.0 * steer, 12.0 * steer, 0, drive, steer, 50.0])
        np.testing.assert_allclose(row, share, atol=0.02)  # the rows' rounded tip
        assert steer == 0.0 or float(ca.mmin(share)) > 0.15, "tyres that work"


def test_a_checked_plan_brakes_with_the_balance_of_the_planned_one() -> None:
    """Written twice; beside another ratio of the pressures it is another force."""
    revised = model_of(race_car_revision(load_car(), "per_axle"), load_car().vehicle, 1000.0)
    problem, theta = Problem(revised.model, declared_settings(load_car())), ca.DM(revised.theta)
    p = {"theta": theta, "phi": ca.DM(revised.constants), "lap": 1000.0, "road_load": [0, 0, 0], "brake_ratio": 0.8}
    z = ca.SX.sym("z", NZ)
    terms = problem.evaluate(z, theta, p)
    planned = ca.Function("planned", [z], [terms.fx_f, terms.fx_r])
    vx, drive = (a.ravel() for a in np.meshgrid([20.0, 45.0, 70.0], [-0.3, -0.1]))
    still = np.zeros_like(vx)
    expected = np.array([planned([0, 0, 0, v, 0, 0, 0, d, 0, v]) for v, d in zip(vx, drive, strict=True)]).squeeze()
    checked, other = (
        forces_of(
            revised.model, revised.theta, revised.constants, np.array([vx, still, still, still, drive, still]), ratio
        )
        for ratio in (0.8, 1.0)
    )
    np.testing.assert_allclose(np.column_stack([checked["fx_f"], checked["fx_r"]]), expected, rtol=1e-3)  # rounded lift
    assert np.all(checked["fx_f"] > other["fx_f"] + 20.0), "less of the braking force in front, N"


def test_a_crest_takes_from_both_axles_what_it_takes_from_the_weight() -> None:
    revised = model_of(race_car_revision(load_car(), "per_axle"), load_car().vehicle, 1000.0)
    motion = some_motion(50)
    felt = []
    for extra in (0.0, -0.4):
        motion[5] = extra
        felt.append(forces_of(revised.model, revised.theta, revised.constants, motion))
    flat, crest = felt
    taken = np.array([flat[name] - crest[name] for name in ("load_f", "load_r")])
    static = [[load_car().vehicle.static_load_front], [load_car().vehicle.static_load_rear]]
    np.testing.assert_allclose(taken, 0.4 * np.tile(static, 50), rtol=1e-6)


def test_the_road_presses_on_a_checked_plan_as_on_the_planned_one(solved: tuple[Controller, Solution]) -> None:
    """Written twice: on a road with grade, bank and vertical curve, at the points of the line itself."""
    line = solved[0].reference.line
    at = 2.0 * np.pi * line.s / line.length
    road = {"grade": 0.08 * np.sin(at), "bank": 0.2 * np.cos(at), "bend": 0.0012 * np.sin(3.0 * at)}
    hilly = replace(line, **road)
    count = solved[1].z.shape[1]
    index = np.linspace(0, len(line.s) - 1, count).astype(int)
    z = solved[1].z.copy()
    z[0], z[1], z[6] = hilly.x[index], hilly.y[index], hilly.s[index]
    z[3], z[5] = np.linspace(20.0, 50.0, count), np.linspace(-0.4, 0.4, count)
    checked = plan_of(replace(solved[1], z=z), Roadside(hilly))["extra_load"]
    _, _, data = Reference(hilly).stages(hilly.s[index] + 1e-6)
    planned = [float(extra_load(data[9:12, k], z[3, k], z[5, k])) for k in range(count)]
    np.testing.assert_allclose(checked, planned, atol=4e-3)  # the plan's lower bound is smooth
    assert np.ptp(checked) > 0.5, "a road that presses"


@pytest.mark.parametrize(("felt", "gap"), [(1.0, 0.0), (0.0, 0.44)])
def test_a_checked_plan_is_slowed_by_the_air_and_pulled_by_the_road(felt: float, gap: float) -> None:
    """Straight ahead without drive at 80 m/s, uphill on a bank, by hand: F = k v^2, g sin(grade), g sin(bank)."""
    revision = race_car_revision(load_car(), "per_axle")
    revised = model_of(revision, load_car().vehicle, 1000.0)
    k = next(effect.parameters["k"] for effect in revision.effects if effect.name == "aero_drag")
    dt, vx, gravity_x, gravity_y = 0.05, 80.0, -9.81 * np.sin(0.02), -9.81 * np.sin(0.35)
    slower = (k * vx**2 / load_car().vehicle.mass - gravity_x) * dt
    columns = {name: np.zeros(2) for name in COLUMNS}
    columns["vx"], columns["vy"] = np.array([vx, vx - felt * slower]), np.array([0.0, felt * gravity_y * dt])
    columns["x"] = np.array([0.0, (vx - 0.5 * felt * slower) * dt])
    columns["y"] = np.array([0.0, 0.5 * columns["vy"][1] * dt])
    columns["gravity_x"], columns["gravity_y"] = np.full(2, gravity_x), np.full(2, gravity_y)
    pair = np.array(list(columns.values()))
    function = CheckedMotion(
        revised.model, literal_load=False, brakes=BrakeLaw(load_car().vehicle, load_car().powertrain)
    ).function(1)
    bounds = Bounds(dt, 0.3, 1.0, (-0.5, 0.3), 1.0, 100.0, (1.3, 1.3), 1.0, 1.0)
    found = np.array(function(pair[:, 0], pair[:, 1], revised.theta, revised.constants, 1.0, bounds.column)).ravel()
    assert found[-1] == pytest.approx(gap, abs=0.06), "of the largest gap that is accepted"


def test_a_start_on_a_straight_says_nothing_of_the_grip_in_bends(case: Case) -> None:
    plan, bounds, check = case
    zero, count = np.zeros_like(plan["vx"]), len(plan["vx"])
    straight = plan.changed(vy=zero, yaw_rate=zero, steer=zero, drive=np.full(count, 0.1), vx=np.full(count, 20.0))
    found = check(straight, bounds)
    assert found.shares[1].min() > 0.3, "the drive loads the rear axle"
    np.testing.assert_allclose(found.across, 0.0, atol=1e-9)


def test_a_plan_for_tyres_that_deliver_less_is_judged_by_what_they_deliver() -> None:
    """In a fast bend, where the yaw rate that full rear tyres lead to differs by more than is let pass."""
    config = load_config(None, {"track": "oval"})
    settings, track = settings_of(config), load_track(config.track)
    adoption = Adoption(config, track, settings, LoadLimits(2.0, 2.0), starting_revision(config, config.planner.model))
    for _ in range(40):
        adoption.take_delivered(Delivered(front=1.0, rear=0.8, brakes=None))
        adoption.catch_up()
    controller = adoption.controller
    assert controller.knowledge.theta[-1] < 0.81 * adoption.current.revised.theta[-1]
    z0 = start_state(controller, 500.0, 0.7)
    controller.cold_start(z0, clock)
    solution = controller.solve(z0, clock, 10)
    assert PlanCheck(settings)(controller, adoption.current.revised, solution) == []

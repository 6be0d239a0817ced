"""Every limit of a plan, and its motion, written a second time: what acceptance judges by.

Eq. (1) to (5) and (10) once more on purpose, apart from the equations of the solver: a check that shared them would
share their mistakes. The motion is judged by another integrator, Hermite-Simpson. With active effects the axle forces
are those of the model; without them Eq. (2) and (3) are written again too. Two laws are the plan's own, because they
say what a limit is: the brake balance (`brake_law`) and what a force along counts (`friction`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from estimator.model.single_track import SIGNALS, SingleTrack, Terms
from estimator.model.tyre import front_and_rear
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Expr
from planner.problem.brake_law import BrakeLaw
from planner.problem.friction import along_share, counted

COLUMNS = (
    "x", "y", "yaw", "vx", "vy", "yaw_rate", "steer", "drive", "extra_load", "offset", "width_left", "width_right",
    "information", "gravity_x", "gravity_y",
)  # fmt: skip
"""of a stage, SI: motion and inputs; what the road adds to the axle loads, over the weight; distance to the left of the
reference line, and from that line to the edges; Delta I; what grade and bank pull along and across the car, m/s2"""
BOUNDS = (
    "dt", "steer", "steer_rate", "drive_low", "drive_high", "drive_rate", "speed", "load_front", "load_rear",
    "clearance", "information",
)  # fmt: skip
"""what a plan must keep to: see `plan.acceptance.Bounds`"""
LIMITS = ("track", "load", "actuator", "rate", "state", "information")
"""how far a stage is beyond each limit, <= 0 inside: m; load, rate and information as shares of their bound; actuator
in its own unit (slip, rad); state m/s"""
FOUND = (*LIMITS, "share_front", "share_rear", "across_front", "across_rear", "gap")
"""beside that the load of both axles over its limit, Eq. (10), its lateral part alone, and the distance from a stage to
the motion by Eq. (1) from the one before"""
HELD = ("steer", "drive", "extra_load", "gravity_x", "gravity_y")
"""what runs straight from stage to stage"""
DEFECT_SCALE = (0.5, 0.5, 0.05, 0.5, 0.5, 0.1)
"""largest such distance, m, m, rad, m/s, m/s, rad/s: one SQP iteration leaves a gap of second order"""
BODY = ("body_x", "body_y", "body_yaw")
FORCES = ("fx_f", "fy_f", "load_f", "fx_r", "fy_r", "load_r", *BODY, "beyond_f", "beyond_r")
"""forces along and across both axles and the axle loads, N; what acts on the body, N and N m; how far C atan(B alpha)
is beyond the peak, rad"""

Forces = dict[str, Expr]
Curve = tuple[Expr, ...]
"""B, C and D of an axle"""

KINEMATIC_SPEED, KINEMATIC_WIDTH = 7.0, 5.0
"""m/s: below it a plan is kinematic and its slip angles mean nothing; so much above it on they count fully"""
MIN_DYNAMIC_SPEED = 12.0
"""m/s: below it the plan is kinematic and its lateral motion is not judged by Eq. (1)"""
LEAST_SPEED = 3.0
"""m/s: of slip angles, which have no meaning at standstill"""


@dataclass(frozen=True)
class CheckedMotion:
    """What the check is made of, for one model: axle forces, and the function over all stages of a plan."""

    model: SingleTrack
    literal_load: bool
    brakes: BrakeLaw

    def function(self, stages: int) -> ca.Function:
        """`stage_function` of so many stages; parameters and bounds are given once."""
        mapped: ca.Function = self.stage_function().map("checked", "serial", stages, [2, 3, 4, 5], [])
        return mapped

    def stage_function(self) -> ca.Function:
        """(before, after, theta, phi, brake ratio, bounds) -> what is found at a stage, rows `FOUND`.

        Rows of `before` (the stage before) and `after` are `COLUMNS`, of `bounds` `BOUNDS`.
        """
        before, after = (ca.SX.sym(name, len(COLUMNS)) for name in ("before", "after"))
        theta, phi = ca.SX.sym("theta", len(self.model.tyre_table)), ca.SX.sym("phi", len(self.model.effect_table))
        ratio, bounds = ca.SX.sym("brake_ratio"), ca.SX.sym("bounds", len(BOUNDS))
        a, b = (dict(zip(COLUMNS, ca.vertsplit(column), strict=True)) for column in (before, after))
        limit = dict(zip(BOUNDS, ca.vertsplit(bounds), strict=True))
        parameters = theta, phi, ratio
        share, across = self._share(b, self.forces(b, *parameters), limit, along_share(self.model, phi))
        gap = self._gap(a, b, limit["dt"], parameters)
        result: Any = ca.densify(ca.vertcat(*_excess(a, b, share, limit), *share, *across, gap))
        arguments: list[Any] = [before, after, *parameters, bounds]
        return ca.Function("checked_stage", arguments, [ca.cse(result)])

    def forces(self, at: Mapping[str, Expr], theta: Expr, phi: Expr, brake_ratio: Expr) -> Forces:
        """`FORCES` at a motion with inputs."""
        named = dict(zip((p.name for p in self.model.tyre_table), ca.vertsplit(theta), strict=True))
        tyres = [axle.of(named) for axle in front_and_rear(self.model.layout)]
        if not self.model.effects:
            return _declared_forces(self.model.vehicle, at, tyres, named["cx"])
        balance = self.brakes.balance(at["vx"], at["drive"], brake_ratio, at["extra_load"])
        aux = {"extra_load": at["extra_load"], "brake_balance": balance}
        terms = Terms(self.model.vehicle, **{name: at[name] for name in SIGNALS}, aux=aux)
        terms = self.model.evaluate(terms, ca.vertsplit(theta), ca.vertsplit(phi) if phi.numel() else [])
        beyond = [
            _beyond_peak(c * ca.atan(b * slip))
            for (b, c, _), slip in zip(tyres, (terms.slip_f, terms.slip_r), strict=True)
        ]
        felt = {name: getattr(terms, name) for name in FORCES[:-2]}
        return felt | dict(zip(FORCES[-2:], beyond, strict=True))

    def _share(
        self, at: Mapping[str, Expr], f: Mapping[str, Expr], limit: Mapping[str, Expr], share: Expr
    ) -> tuple[list[Expr], list[Expr]]:
        """Load of the front and of the rear axle over its limit, Eq. (10), and its lateral part alone.

        Beyond the peak the force falls and a share goes on rising: a slide is no way to keep to a limit.
        """
        dynamic = ca.fmin(ca.fmax((at["vx"] - KINEMATIC_SPEED) / KINEMATIC_WIDTH, 0.0), 1.0)
        shares, lateral = [], []
        for axle, most in (("f", limit["load_front"]), ("r", limit["load_rear"])):
            across = dynamic * f[f"fy_{axle}"]
            along = f[f"fx_{axle}"]
            along = counted(share, across / (most * f[f"load_{axle}"]), along) * along
            force = ca.fabs(along + across) if self.literal_load else ca.sqrt(along**2 + across**2)
            shares.append(force / (most * f[f"load_{axle}"]) + dynamic * f[f"beyond_{axle}"])
            lateral.append(ca.fabs(across) / (most * f[f"load_{axle}"]))
        return shares, lateral

    def _gap(self, a: Mapping[str, Expr], b: Mapping[str, Expr], dt: Expr, parameters: tuple[Expr, Expr, Expr]) -> Expr:
        """Largest Hermite-Simpson defect, in units of `DEFECT_SCALE`; inputs run straight from stage to stage.

        `parameters` as `forces` takes them. Source: Hargraves & Paris, J. Guidance 10 (1987).
        """
        vehicle = self.model.vehicle
        state, after = (ca.vertcat(*(at[name] for name in COLUMNS[:6])) for at in (a, b))
        slopes = [_motion(at, self.forces(at, *parameters), vehicle) for at in (a, b)]
        middle = 0.5 * (state + after) + dt / 8 * (slopes[0] - slopes[1])
        held = {name: 0.5 * (a[name] + b[name]) for name in HELD}
        between = dict(zip(COLUMNS[:6], ca.vertsplit(middle), strict=True)) | held
        slope = _motion(between, self.forces(between, *parameters), vehicle)
        gap = after - state - dt / 6 * (slopes[0] + 4 * slope + slopes[1])
        judged = ca.vertcat(1, 1, 1, 0, 1, 1) * (a["vx"] > MIN_DYNAMIC_SPEED) + ca.DM([0, 0, 0, 1, 0, 0])
        return ca.mmax(ca.fabs(gap * judged / ca.DM(DEFECT_SCALE)))


def _declared_forces(vehicle: Vehicle, at: Mapping[str, Expr], tyres: Sequence[Curve], cx: Expr) -> Forces:
    """Eq. (2) and (3) of the declared model."""
    forces: Forces = {"fx_f": ca.SX(0.0), "fx_r": cx * at["drive"], **dict.fromkeys(BODY, ca.SX(0.0))}
    axles = (
        ("f", at["steer"], vehicle.lf, vehicle.static_load_front),
        ("r", 0.0, -vehicle.lr, vehicle.static_load_rear),
    )
    for (axle, steer, arm, static), (b, c, d) in zip(axles, tyres, strict=True):
        slip = steer - ca.atan((at["vy"] + arm * at["yaw_rate"]) / ca.fmax(at["vx"], LEAST_SPEED))
        phase = c * ca.atan(b * slip)
        forces[f"load_{axle}"] = static * (1.0 + at["extra_load"])
        forces[f"fy_{axle}"] = d * forces[f"load_{axle}"] * ca.sin(phase)
        forces[f"beyond_{axle}"] = _beyond_peak(phase)
    return forces


def _beyond_peak(phase: Expr) -> Expr:
    """How far C atan(B alpha) of Eq. (2) is beyond the peak of the force, rad."""
    return ca.fmax(ca.fabs(phase) - 0.5 * ca.pi, 0.0)


def _excess(
    a: Mapping[str, Expr], b: Mapping[str, Expr], share: list[Expr], limit: Mapping[str, Expr]
) -> tuple[Expr, ...]:
    step = {name: ca.fabs(b[name] - a[name]) / (limit[f"{name}_rate"] * limit["dt"]) for name in ("steer", "drive")}
    left, right = (
        side * b["offset"] + limit["clearance"] - b[f"width_{name}"] for side, name in ((1, "left"), (-1, "right"))
    )
    return (
        ca.fmax(left, right),
        ca.fmax(*share) - 1.0,
        ca.fmax(
            ca.fabs(b["steer"]) - limit["steer"],
            ca.fmax(b["drive"] - limit["drive_high"], limit["drive_low"] - b["drive"]),
        ),
        ca.fmax(step["steer"], step["drive"]) - 1.0,
        ca.fmax(b["vx"] - limit["speed"], -b["vx"]),
        b["information"] / limit["information"] - 1.0,
    )


def _motion(at: Mapping[str, Expr], f: Mapping[str, Expr], vehicle: Vehicle) -> Expr:
    """Eq. (1)."""
    cos_yaw, sin_yaw, cos_steer, sin_steer = (g(at[name]) for name in ("yaw", "steer") for g in (ca.cos, ca.sin))
    vx, vy, rate = at["vx"], at["vy"], at["yaw_rate"]
    front_x = f["fx_f"] * cos_steer - f["fy_f"] * sin_steer
    front_y = f["fy_f"] * cos_steer + f["fx_f"] * sin_steer
    return ca.vertcat(
        vx * cos_yaw - vy * sin_yaw,
        vx * sin_yaw + vy * cos_yaw,
        rate,
        (f["fx_r"] + front_x + f["body_x"]) / vehicle.mass + vy * rate + at["gravity_x"],
        (f["fy_r"] + front_y + f["body_y"]) / vehicle.mass - vx * rate + at["gravity_y"],
        (front_y * vehicle.lf - f["fy_r"] * vehicle.lr + f["body_yaw"]) / vehicle.yaw_inertia,
    )

"""Declared vehicle data that may be wrong, as candidates beside the effects: reported apart, as data to correct.

Only what a log of motion can tell is here. The mass divides out of Eq. (1) where tyre forces are in proportion to
the load; a wrong steering ratio is `steer_scale`; with it, a wrong wheelbase differs from a wrong centre of gravity
only by the place of one axle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from estimator.model.effect import Effect
from estimator.model.effects import catalogue
from estimator.model.look_alikes import LOOK_ALIKES
from estimator.model.parameters import Parameter, Plausible
from estimator.model.single_track import Terms
from estimator.model.tyre import blend_speed, safe_speed
from hil_gateway.car.vehicle import GRAVITY, Vehicle
from hil_gateway.process.arrays import Expr


def _inertia(terms: Terms, factor: Expr) -> None:
    terms.yaw_acc = terms.yaw_acc / factor


def _slip(terms: Terms, ahead: Expr) -> None:
    turned = ahead * terms.yaw_rate / safe_speed(terms.vx, blend_speed(terms.vehicle))
    terms.slip_f, terms.slip_r = terms.slip_f + turned, terms.slip_r + turned


def _load(terms: Terms, ahead: Expr) -> None:
    moved = ahead * terms.vehicle.mass * GRAVITY / terms.vehicle.wheelbase
    terms.load_f, terms.load_r = terms.load_f + moved, terms.load_r - moved


def _moment(terms: Terms, ahead: Expr) -> None:
    terms.body_yaw = terms.body_yaw - ahead * (terms.fy_f + terms.fy_r)


YAW_INERTIA = Effect(
    name="vehicle_yaw_inertia",
    lacks="the declared yaw inertia is wrong",
    equation="dw/dt = M / (k I_z)",
    source="Eq. (1)",
    parameters=(
        Parameter(
            "factor",
            "1",
            1.0,
            0.2,
            0.4,
            2.5,
            "true over declared yaw inertia",
            Plausible(0.5, 2.0, "same kind of car; a swing test is good to 5 %", 0.05),
        ),
    ),
    channels=("yaw_acc",),
    cause="steer",
    hooks={"MOTION": _inertia},
    separated_by="quick turn-in; damping of yaw acts in steady cornering too",
)

CENTRE_OF_GRAVITY = Effect(
    name="vehicle_lf",
    lacks="the declared centre of gravity is wrong",
    equation="L_f = L_f0 - x, L_r = L_r0 + x in slips, loads and moment",
    source="Eq. (1) and (3)",
    parameters=(
        Parameter(
            "ahead", "m", 0.0, 0.1, -0.8, 0.8, "true centre of gravity ahead of the declared one",
            Plausible(-0.6, 0.6, "inside the wheelbase of any car; fuel moves it by 2 cm", 0.02),
        ),
    ),
    channels=("ay", "yaw_acc", "vy_dot"),
    cause="steer",
    hooks={"SLIP": _slip, "LOAD": _load, "BODY": _moment},
    separated_by="the balance of the axles at all slips; tyres differ in their shape",
)  # fmt: skip


@dataclass(frozen=True)
class DeclaredDatum:
    """A key of the vehicle file, its unit, the candidate, and its value by the vehicle and the found parameter."""

    name: str
    unit: str
    effect: Effect
    found: Callable[[Vehicle, float], float]


DECLARED: Mapping[str, DeclaredDatum] = {
    d.effect.name: d
    for d in (
        DeclaredDatum("yaw_inertia", "kg m2", YAW_INERTIA, lambda v, factor: v.yaw_inertia * factor),
        DeclaredDatum("lf", "m", CENTRE_OF_GRAVITY, lambda v, ahead: v.lf - ahead),
    )
}
"""Candidates by effect name."""


def id_of(name: str) -> str:
    """Name that a candidate is reported under."""
    return all_candidates()[name].id


def all_candidates() -> dict[str, Effect]:
    """The catalogue with the look-alikes of its effects, then the declared data; what has memory follows its causes."""
    effects = {**catalogue(), **LOOK_ALIKES}
    return dict(sorted(effects.items())) | {name: datum.effect for name, datum in DECLARED.items()}

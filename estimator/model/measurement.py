"""The one measurement model h(x, u, theta) that Eq. (7) and Eq. (8) share.

Three variants of z, chosen by name:

- `imu`: specific forces a_x, a_y at the CoG, the paper's section III (tyre forces put into Eq. 1);
- `imu_yaw`: the same plus the yaw acceleration, which tells the two axles apart;
- `tyre_force`: F_rx, F_fy, F_ry as in the paper's section II-C (F_fx is identically zero on a car driven
  at the rear, so its row carries no information and is left out).

Effects of the active model act on every variant, because all go through `SingleTrack.evaluate`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import casadi as ca
import numpy as np
import numpy.typing as npt

from estimator.model.single_track import AUXILIARY, SIGNALS, SingleTrack, Terms
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Expr
from hil_gateway.process.compiled import EXACT, CompiledFunction, compile_function

MeasurementKind = Literal["imu", "imu_yaw", "tyre_force"]

CHANNELS: Mapping[MeasurementKind, tuple[str, ...]] = {
    "imu": ("imu_ax", "imu_ay"),
    "imu_yaw": ("imu_ax", "imu_ay", "yaw_acc"),
    "tyre_force": ("fx_r", "fy_f", "fy_r"),
}
"""Attribute of `Terms` behind each row of z."""


def measurement(
    model: SingleTrack,
    kind: MeasurementKind,
    signals: Sequence[Expr],
    theta: Sequence[Expr],
    phi: Sequence[Expr] = (),
    *,
    aux: Mapping[str, Expr] | None = None,
) -> Expr:
    """h(x, u, theta): predicted z, shape (len(CHANNELS[kind]), 1), m/s2, rad/s2 or N.

    `signals` are vx, vy, yaw_rate, steer, drive; `aux` may hold any of `AUXILIARY` (missing ones are 0).
    """
    filled = {name: (aux or {}).get(name, 0.0) for name in AUXILIARY}
    terms = model.evaluate(Terms(model.vehicle, **dict(zip(SIGNALS, signals, strict=True)), aux=filled), theta, phi)
    return ca.vertcat(*(getattr(terms, name) for name in CHANNELS[kind]))


def measurement_function(
    model: SingleTrack, kind: MeasurementKind, *, with_effects: bool = False, vehicle: Expr | None = None
) -> ca.Function:
    """CasADi function (signals[5], aux[len(AUXILIARY)], theta, phi) -> (h, dh/dtheta, dh/dsignals).

    `with_effects`: theta are tyre parameters, then those of the effects, and phi is not looked at. `vehicle`: numbers
    of the car where they are symbols, one more input.
    """
    signals, aux = ca.SX.sym("signals", len(SIGNALS)), ca.SX.sym("aux", len(AUXILIARY))
    theta, phi = ca.SX.sym("theta", len(model.tyre_table)), ca.SX.sym("phi", len(model.effect_table))
    named = dict(zip(AUXILIARY, ca.vertsplit(aux), strict=True))
    h = measurement(model, kind, ca.vertsplit(signals), ca.vertsplit(theta), _split(phi), aux=named)
    learnt = ca.vertcat(theta, phi) if with_effects else theta
    unseen = ca.SX.sym("unseen", phi.numel()) if with_effects else phi
    results = [ca.densify(e) for e in (h, ca.jacobian(h, learnt), ca.jacobian(h, signals))]
    given = {"signals": signals, "aux": aux, "theta": learnt, "phi": unseen}
    given |= {} if vehicle is None else {"vehicle": vehicle}
    return ca.Function("measurement", [*given.values()], results, [*given], ["h", "h_theta", "h_signals"])


def of_any_car(model: SingleTrack) -> tuple[SingleTrack, Expr]:
    """The same model of a car whose numbers are symbols, and these: what is compiled of it serves all cars."""
    names = list(Vehicle.model_fields)
    numbers = ca.SX.sym("vehicle", len(names))
    symbols: dict[str, Any] = dict(zip(names, ca.vertsplit(numbers), strict=True))
    return replace(model, vehicle=Vehicle.model_construct(**symbols)), numbers


def compiled_for(vehicle: Vehicle, function: ca.Function) -> CompiledFunction:
    """A function whose last input is the numbers of a car, with those of `vehicle`."""
    compiled = compile_function(function, flags=EXACT)
    compiled.inputs[-1][:, 0] = list(vehicle.model_dump().values())
    return compiled


def axle_forces(vehicle: Vehicle, ax: float, ay: float, yaw_acc: float, steer: float) -> npt.NDArray[np.float64]:
    """Inverse of Eq. (1): F_rx, F_fy, F_ry, N, that explain specific forces (m/s2) and yaw acceleration (rad/s2).

    Turns what the car can measure into the z of the `tyre_force` variant; F_fx is taken as zero.
    """
    v = vehicle
    front_y = (v.yaw_inertia * yaw_acc + v.lr * v.mass * ay) / v.wheelbase
    fy_f = front_y / np.cos(steer)
    return np.array([v.mass * ax + fy_f * np.sin(steer), fy_f, v.mass * ay - front_y])


def _split(vector: Expr) -> list[Expr]:
    return ca.vertsplit(vector) if vector.numel() else []

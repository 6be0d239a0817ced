"""What is declared of the race car beyond Eq. (1)-(3): air, load transfer and the brakes of both axles, as effects.

Nominal values come from the data sheet (`hil_gateway.car`), never from a car that was driven. How well they are known
is stated beside them, and the belief goes on from there while driving.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from estimator.model.parameters import DEFAULT_TYRE, Layout
from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.arrays import Array

AERO_STD = 0.10
"""relative; a wind tunnel against the road, and wings set for the track"""
HEIGHT_STD = 0.15
"""relative; a centre of gravity's height is the least well weighed"""
LOAD_SENSITIVITY = (0.10, 0.06)
"""value and absolute standard deviation: racing tyres lose 5 to 20 % of their friction when the load doubles (Milliken
and Milliken, Race Car Vehicle Dynamics, ch. 2)"""
ELLIPSE = (0.80, 0.15)
"""value and absolute standard deviation of lateral over longitudinal friction: by similarity (Pacejka, Tire and Vehicle
Dynamics, ch. 3.3) a longitudinal force of half the peak takes 3 % of the lateral force at small slip angles and one of
0.9 takes 30 %, as ellipses with 0.5 and 0.8 do; at the peak they have 0.95. Without it what an axle loses under power
or brakes passes for load transfer that is not there"""
BRAKE_SHARE = 0.5
"""of the front axle at equal pressures: `Powertrain.brake_force_per_pa` is that of either axle"""
BRAKE_SHARE_STD = 0.04
"""absolute, about 8 %: pads, discs and the bias valve"""
BRAKES_STD = 0.10
"""relative, of the brakes' force per unit of command: pads, discs, how warm they are"""
TYRE_STD: Mapping[str, float] = {"cx": 0.10, "b": 0.20, "c": 0.08, "d": 0.15}
"""relative; grip of a set of tyres on a track differs by a fifth at most from what is declared, the shape of the curve
by less, the slip at which it peaks by more; C_x has the engine's force per unit of command"""


@dataclass(frozen=True)
class DeclaredParameter:
    """Value and standard deviation, SI, of one parameter of an effect."""

    value: float
    std: float


def declared_effects(vehicle: Vehicle) -> dict[str, dict[str, DeclaredParameter]]:
    """Effects of the race car with nominal values: effect -> parameter -> value and how well it is known."""
    v, pressure = vehicle, 0.5 * vehicle.air_density
    drag, front, rear = (pressure * area for area in (v.drag_area, -v.lift_area_front, -v.lift_area_rear))
    return {
        "aero_drag": {"k": DeclaredParameter(drag, AERO_STD * drag)},
        "aero_downforce": {
            "k_front": DeclaredParameter(front, AERO_STD * front),
            "k_rear": DeclaredParameter(rear, AERO_STD * rear),
        },
        "load_transfer": {"height": DeclaredParameter(v.cg_height, HEIGHT_STD * v.cg_height)},
        "load_sensitivity": {"k": DeclaredParameter(*LOAD_SENSITIVITY)},
        "combined_slip": {"k": DeclaredParameter(*ELLIPSE)},
        "front_brake": {
            "share": DeclaredParameter(BRAKE_SHARE, BRAKE_SHARE_STD),
            "gain": DeclaredParameter(1.0, float(np.hypot(BRAKES_STD, TYRE_STD["cx"]))),
        },
    }


def declared_tyre_std(layout: Layout) -> dict[str, float]:
    """Standard deviation of every declared tyre parameter of a race car, SI."""
    return {name: value * TYRE_STD["cx" if name == "cx" else name[0]] for name, value in DEFAULT_TYRE[layout].items()}


def declared_covariance(layout: Layout, vehicle: Vehicle) -> Array:
    """Of the tyre parameters of a race car and those of its declared effects after them (n, n), SI.

    The gain of the brakes is their force over the engine's, which do not know of each other: an engine that turns out
    weak says that the gain is larger, and nothing of the brakes.
    """
    known = {f"{e}.{key}": p.std for e, named in declared_effects(vehicle).items() for key, p in named.items()}
    tyres = declared_tyre_std(layout)
    names, std = [*tyres, *known], np.array([*tyres.values(), *known.values()])
    covariance = np.diag(std**2)
    engine, gain = names.index("cx"), names.index("front_brake.gain")
    covariance[engine, gain] = covariance[gain, engine] = -TYRE_STD["cx"] * tyres["cx"]
    return covariance

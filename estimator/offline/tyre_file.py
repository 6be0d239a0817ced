"""Tyre property files (.tir) of the Magic Formula as a prior of Eq. (2): its shape, peak and cornering stiffness.

Pacejka, Tire and Vehicle Dynamics, ch. 4.3.2 (4.E15, 4.E19 to 4.E25) at zero camber and nominal pressure: at the load
of a wheel C = p_Cy1, D = mu_y, B C D = K_ya / F_z, and C_x = K_xk. Shifts and curvature (E) are not in Eq. (2).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path

from hil_gateway.car.vehicle import Vehicle
from hil_gateway.process.errors import InputError
from hil_gateway.text_file import read_text

NEEDED = ("PCY1", "PDY1", "PKY1")
_ENTRY = re.compile(r"\s*([A-Za-z]\w*)\s*=\s*([^$]*)")


def read_tyre_file(path: Path, vehicle: Vehicle) -> dict[str, float]:
    """Tyre prior per axle, without `cx` where the file has no longitudinal force.

    Raises:
        InputError: unreadable, or a coefficient is missing or no number.
    """
    values = _coefficients(path)
    for name in NEEDED:
        if name not in values:
            raise InputError(f"{path}: {name} is missing: a prior needs {', '.join(NEEDED)}")
    loads = {"f": vehicle.static_load_front / 2, "r": vehicle.static_load_rear / 2}
    prior = {f"{n}{axle}": v for axle, load in loads.items() for n, v in _curve(values, load).items()}
    if "PKX1" in values:
        prior["cx"] = 2.0 * loads["r"] * _slip_stiffness(values, loads["r"])
    return prior


def _coefficients(path: Path) -> dict[str, float]:
    """Every entry that is a number."""
    found = (_ENTRY.match(line) for line in read_text(path, "tyre").splitlines())
    values = {}
    for entry in filter(None, found):
        try:
            values[entry[1].upper()] = float(entry[2])
        except ValueError:
            continue  # texts, as the file's version
    return values


def _curve(values: Mapping[str, float], load: float) -> dict[str, float]:
    """B, C and D of one tyre at a load, N."""
    nominal = values.get("FNOMIN", load) * values.get("LFZO", 1.0)
    increment = (load - nominal) / nominal
    C = values["PCY1"] * values.get("LCY", 1.0)
    D = (values["PDY1"] + values.get("PDY2", 0.0) * increment) * values.get("LMUY", 1.0)
    K = abs(values["PKY1"]) * values.get("LKY", 1.0) * nominal / load * _growth(values, load / nominal)
    return {"b": K / (abs(C * D) or 1.0), "c": abs(C), "d": abs(D)}


def _growth(values: Mapping[str, float], ratio: float) -> float:
    """Share of the greatest cornering stiffness at `ratio` of the nominal load; in proportion where it is not there."""
    if "PKY2" not in values or values["PKY2"] == 0.0:
        return ratio
    return abs(math.sin(values.get("PKY4", 2.0) * math.atan(ratio / values["PKY2"])))


def _slip_stiffness(values: Mapping[str, float], load: float) -> float:
    """K_xk over the load."""
    nominal = values.get("FNOMIN", load)
    increment = (load - nominal) / nominal
    growth = math.exp(values.get("PKX3", 0.0) * increment) * values.get("LKX", 1.0)
    return (values["PKX1"] + values.get("PKX2", 0.0) * increment) * growth

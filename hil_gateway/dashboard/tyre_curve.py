"""Lateral tyre curves of the belief for drawing: Eq. (2) over slip angle, with the band of its standard deviation."""

from __future__ import annotations

from typing import Any

import numpy as np

from hil_gateway.bus.messages import Belief
from hil_gateway.process.arrays import Array

LARGEST_DEG = 12.0
AXLES = {"front": ("bf", "cf", "df"), "rear": ("br", "cr", "dr")}


def curves(belief: Belief) -> dict[str, Any]:
    """Slip angles (deg) and, for each axle, lateral force over axle load: mean and standard deviation (first order).

    Both are empty for an axle whose parameters the belief does not hold.
    """
    slip_deg = np.linspace(0.0, LARGEST_DEG)
    drawn: dict[str, Any] = {"slip_deg": slip_deg.round(3).tolist()}
    for axle, names in AXLES.items():
        symbols = names if names[0] in belief.names else tuple(name[0] for name in names)
        if not set(symbols) <= set(belief.names):
            drawn[axle] = {"mean": [], "std": []}
            continue
        index = [belief.names.index(symbol) for symbol in symbols]
        theta = np.array([belief.mean[i] for i in index])
        covariance = np.array(belief.covariance)[np.ix_(index, index)]
        force, jacobian = _force(theta, np.radians(slip_deg))
        std = np.sqrt(np.maximum(np.einsum("ip,ij,jp->p", jacobian, covariance, jacobian), 0.0))
        drawn[axle] = {"mean": force.round(4).tolist(), "std": std.round(4).tolist()}
    return drawn


def _force(theta: Array, slip: Array) -> tuple[Array, Array]:
    """(n,) D sin(C atan(B slip)) and (3, n) its derivatives by B, C and D."""
    b, c, d = theta
    turned = np.arctan(b * slip)
    across = d * np.cos(c * turned)
    by_parameter = across * c * slip / (1.0 + (b * slip) ** 2), across * turned, np.sin(c * turned)
    return d * np.sin(c * turned), np.array(by_parameter)

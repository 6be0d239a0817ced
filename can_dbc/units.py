"""Units of the DBC and their SI factor: units change here and nowhere else in the project."""

from __future__ import annotations

import math

GRAVITY = 9.80665
"""Standard gravity, m/s2 (CGPM 1901)."""

SI: dict[str, float] = {
    "": 1.0,  # a count
    "A": 1.0,  # A
    "N": 1.0,  # N
    "Nm": 1.0,  # N m
    "V": 1.0,  # V
    "m": 1.0,  # m
    "s": 1.0,  # s
    "degC": 1.0,  # a temperature stays in degrees Celsius: nothing here multiplies one
    "%": 0.01,  # 1
    "deg": math.pi / 180,  # rad
    "deg/s": math.pi / 180,  # rad/s
    "g": GRAVITY,  # m/s2
    "kPa": 1e3,  # Pa
    "kmph": 1 / 3.6,  # m/s
    "mbar": 100.0,  # Pa
    "mph": 0.44704,  # m/s
    "ms": 1e-3,  # s
    "psi": 6894.757293168,  # Pa
    "rpm": 2 * math.pi / 60,  # rad/s
}
"""DBC unit -> factor: value_SI = factor * value_DBC, in the unit behind it."""

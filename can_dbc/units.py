"""Units of the DBC and of car files, with their SI factor: units change here and nowhere else in the project."""

from __future__ import annotations

import math
from typing import NamedTuple

GRAVITY = 9.80665
"""Standard gravity, m/s2 (CGPM 1901)."""
ATMOSPHERE = 101_325.0
"""Standard atmosphere, Pa (CGPM 1954)."""
_DEGREE, _POUND_FORCE = math.pi / 180, 4.4482216152605


class Unit(NamedTuple):
    """value_SI = factor * value, in `si`."""

    factor: float
    si: str


UNITS: dict[str, Unit] = {
    "": Unit(1.0, "1"),  # a count
    "1": Unit(1.0, "1"),
    "%": Unit(0.01, "1"),
    "permille": Unit(1e-3, "1"),
    "%/s": Unit(0.01, "1/s"),
    "1/s": Unit(1.0, "1/s"),
    "Hz": Unit(1.0, "Hz"),
    "A": Unit(1.0, "A"),
    "V": Unit(1.0, "V"),
    "mV": Unit(1e-3, "V"),
    "N": Unit(1.0, "N"),
    "kN": Unit(1e3, "N"),
    "lbf": Unit(_POUND_FORCE, "N"),
    "Nm": Unit(1.0, "N m"),
    "N m": Unit(1.0, "N m"),
    "lbf ft": Unit(_POUND_FORCE * 0.3048, "N m"),
    "W": Unit(1.0, "W"),
    "kW": Unit(1e3, "W"),
    "hp": Unit(745.69987158227, "W"),  # mechanical
    "m": Unit(1.0, "m"),
    "cm": Unit(1e-2, "m"),
    "mm": Unit(1e-3, "m"),
    "in": Unit(0.0254, "m"),
    "ft": Unit(0.3048, "m"),
    "m2": Unit(1.0, "m2"),
    "kg": Unit(1.0, "kg"),
    "lb": Unit(0.45359237, "kg"),
    "kg m2": Unit(1.0, "kg m2"),
    "kg/m3": Unit(1.0, "kg/m3"),
    "N/Pa": Unit(1.0, "N/Pa"),
    "s": Unit(1.0, "s"),
    "min": Unit(60.0, "s"),
    "ms": Unit(1e-3, "s"),
    "us": Unit(1e-6, "s"),
    "degC": Unit(1.0, "degC"),  # a temperature stays in degrees Celsius: nothing here multiplies one
    "rad": Unit(1.0, "rad"),
    "mrad": Unit(1e-3, "rad"),
    "deg": Unit(_DEGREE, "rad"),
    "rad/s": Unit(1.0, "rad/s"),
    "deg/s": Unit(_DEGREE, "rad/s"),
    "rpm": Unit(2 * math.pi / 60, "rad/s"),
    "m/s": Unit(1.0, "m/s"),
    "kmph": Unit(1 / 3.6, "m/s"),
    "km/h": Unit(1 / 3.6, "m/s"),
    "mph": Unit(0.44704, "m/s"),
    "kn": Unit(1852.0 / 3600.0, "m/s"),
    "m/s2": Unit(1.0, "m/s2"),
    "g": Unit(GRAVITY, "m/s2"),
    "mg": Unit(1e-3 * GRAVITY, "m/s2"),
    "Pa": Unit(1.0, "Pa"),
    "kPa": Unit(1e3, "Pa"),
    "MPa": Unit(1e6, "Pa"),
    "bar": Unit(1e5, "Pa"),
    "mbar": Unit(100.0, "Pa"),
    "psi": Unit(6894.757293168, "Pa"),
    "Pa/s": Unit(1.0, "Pa/s"),
    "kPa/s": Unit(1e3, "Pa/s"),
    "bar/s": Unit(1e5, "Pa/s"),
}
"""Unit as it is written -> factor and SI unit."""

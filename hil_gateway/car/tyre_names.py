"""Names and units of the tyre parameters of Eq. (2), as people read them."""

from __future__ import annotations

from typing import NamedTuple


class Named(NamedTuple):
    """A parameter for people."""

    name: str
    unit: str
    """empty: it has none"""


TYRE_NAMES: dict[str, Named] = {
    "cx": Named("drive stiffness C_x", "N"),
    "b": Named("stiffness factor B", "1/rad"),
    "c": Named("shape factor C", ""),
    "d": Named("friction D", ""),
    "bf": Named("front stiffness factor B", "1/rad"),
    "cf": Named("front shape factor C", ""),
    "df": Named("front friction D", ""),
    "br": Named("rear stiffness factor B", "1/rad"),
    "cr": Named("rear shape factor C", ""),
    "dr": Named("rear friction D", ""),
}
"""symbol -> name, unit (C_x is a force per unit of slip ratio, D a force over the axle load)"""


def named(symbol: str) -> Named:
    """Name and unit of a parameter; its symbol where it has none."""
    return TYRE_NAMES.get(symbol, Named(symbol.replace("_", " "), ""))


def label(symbol: str) -> str:
    """Name, symbol and unit of a parameter, as a table of a report has them."""
    name, unit = named(symbol)
    return (f"{name} ({symbol})" if symbol in TYRE_NAMES else name) + (f", {unit}" if unit else "")

"""What a drive log's columns are: quantities, the names loggers give them, and the units those come in.

A name or a unit that is not here is no guess: the column is carried along as it is, and `--columns` says what it is.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from can_dbc import units
from hil_gateway.car.vehicle import GRAVITY

DEGREE = units.UNITS["deg"].factor
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0},
    "speed": {
        "m/s": 1.0, "mps": 1.0, "m s-1": 1.0, "km/h": 1 / 3.6, "kmh": 1 / 3.6, "kph": 1 / 3.6, "kmph": 1 / 3.6,
        "mph": 0.44704, "kn": 0.514444, "knots": 0.514444, "ft/s": 0.3048, "mm/s": 1e-3,
    },
    "rate": {
        "rad/s": 1.0, "rads": 1.0, "1/s": 1.0, "deg/s": DEGREE, "degs": DEGREE, "deg/sec": DEGREE, "dps": DEGREE,
        "rpm": math.pi / 30.0, "1/min": math.pi / 30.0, "r/min": math.pi / 30.0, "mrad/s": 1e-3,
    },
    "acceleration": {"m/s2": 1.0, "m/s/s": 1.0, "mps2": 1.0, "m s-2": 1.0, "g": GRAVITY, "mg": 1e-3 * GRAVITY},
    "angle": {"rad": 1.0, "deg": DEGREE, "degrees": DEGREE, "mrad": 1e-3},
    "length": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "ft": 0.3048},
    "share": {"1": 1.0, "%": 1e-2, "pct": 1e-2, "ratio": 1.0, "percent": 1e-2},
    "pressure": {"pa": 1.0, "kpa": 1e3, "mpa": 1e6, "bar": 1e5, "mbar": 1e2, "psi": 6894.757, "1": 1.0, "%": 1e-2},
    "number": {"1": 1.0, "": 1.0},
}  # fmt: skip
"""dimension -> unit -> SI"""
NO_UNIT = frozenset({"-", "1", "n/a", "na", "none", "#", "", "unitless", "bool", "enum", "lap", "gear", "no", "counts"})


@dataclass(frozen=True)
class ColumnQuantity:
    """A column of the drive log: its dimension and the names loggers give it, in small letters without marks."""

    dimension: str
    names: tuple[str, ...] = ()


QUANTITIES: Mapping[str, ColumnQuantity] = {
    "t": ColumnQuantity("time", ("time", "timestamp", "times", "elapsedtime", "logtime", "sessiontime", "timestamps")),
    "vx": ColumnQuantity("speed", (
        "groundspeed", "speed", "vehiclespeed", "velocityx", "longitudinalvelocity", "vlong", "velx", "speedx", "u",
        "longvelocity", "gpsspeed", "velocity", "forwardvelocity", "vehspeed", "carspeed", "corrspeed",
    )),
    "vy": ColumnQuantity("speed", (
        "lateralvelocity", "velocityy", "vlat", "vely", "speedy", "latvelocity", "sidespeed", "lateralspeed",
    )),
    "yaw_rate": ColumnQuantity("rate", (
        "yawrate", "yawvelocity", "gyroz", "gyroyaw", "gyroyawvelocity", "omegaz", "wz", "rateyaw", "angularvelocityz",
        "yawspeed", "gyroscopez", "imuyawrate", "r",
    )),
    "ax": ColumnQuantity("acceleration", (
        "gforcelong", "accelx", "accx", "accelerationx", "longacc", "longitudinalacceleration", "glong", "longg",
        "along", "accellong", "longaccel", "inlineacc", "longitudinalaccel", "gpslongacc", "longitudinalg",
    )),
    "ay": ColumnQuantity("acceleration", (
        "gforcelat", "accely", "accy", "accelerationy", "latacc", "lateralacceleration", "glat", "latg", "alat",
        "accellat", "lataccel", "lateralacc", "lateralaccel", "gpslatacc", "lateralg",
    )),
    "az": ColumnQuantity("acceleration", ("gforcevert", "accelz", "accz", "accelerationz", "vertacc", "gvert")),
    "steer": ColumnQuantity("angle", (
        "steeredangle", "steering", "steerangle", "steeringangle", "roadwheelangle", "steeringwheelangle", "delta",
        "steeringpos", "steerpos", "swa", "handwheelangle", "wheelangle",
    )),
    "drive": ColumnQuantity("number", ("slipcommand", "drivecommand")),
    "x": ColumnQuantity("length", ("posx", "positionx", "east", "easting", "xm", "gpsx", "localx")),
    "y": ColumnQuantity("length", ("posy", "positiony", "north", "northing", "ym", "gpsy", "localy")),
    "z": ColumnQuantity("length", ("altitude", "height", "posz", "gpsaltitude", "elevation")),
    "yaw": ColumnQuantity("angle", ("psi", "yawangle")),
    "lap": ColumnQuantity("number", ("lapnumber", "lapno", "lapcount")),
    "throttle": ColumnQuantity("share", (
        "throttlepos", "throttleposition", "throttlepedal", "accelerator", "acceleratorpedal", "tps", "gas",
        "throttlepedalpos", "pedalpos",
    )),
    "brake": ColumnQuantity("pressure", (
        "brakepressure", "brakepres", "brakepos", "brakepedal", "brakepedalpos", "brakepress",
    )),
    "gear": ColumnQuantity("number", ("gearpos", "gearposition", "currentgear", "gearno")),
    "engine_speed": ColumnQuantity("rate", ("enginerpm", "rpm", "enginespeed", "motorrpm")),
    **{
        f"wheel_speed_{wheel}": ColumnQuantity("speed", (
            f"wheelspeed{wheel}", f"{wheel}wheelspeed", f"ws{wheel}", f"speed{wheel}", f"wheelspeed{long}",
        ))
        for wheel, long in (("fl", "frontleft"), ("fr", "frontright"), ("rl", "rearleft"), ("rr", "rearright"))
    },
}  # fmt: skip
"""columns of docs/formats.md"""
SUFFIX_UNITS: Mapping[str, str] = {
    "mps": "m/s", "kmh": "km/h", "kph": "kph", "mph": "mph", "deg": "deg", "degs": "deg/s", "dps": "dps", "rad": "rad",
    "rads": "rad/s", "radps": "rad/s", "degps": "deg/s", "g": "g", "mps2": "m/s2", "ms": "ms", "s": "s", "ns": "ns",
    "us": "us", "rpm": "rpm", "m": "m", "bar": "bar", "kpa": "kpa", "pct": "%", "percent": "%", "ms2": "m/s2",
}  # fmt: skip
"""end of a name behind an underscore -> unit"""


def normal_unit(text: str) -> str:
    """One spelling of a unit: small letters, plain marks, no brackets."""
    plain = text.strip().strip("[]()").lower().replace("²", "2").replace("^", "").replace("°", "deg").replace("**", "")
    return re.sub(r"\s+", " ", plain.replace("·", " ").replace("*", " ").replace("degree/s", "deg/s")).strip()


def is_unit(text: str) -> bool:
    """Whether a cell names a unit, or says that there is none."""
    unit = normal_unit(text)
    return unit in NO_UNIT or any(unit in known for known in UNITS.values())


def to_si(name: str, unit: str) -> float | None:
    """Factor from `unit` to the SI of the column `name`; None where the unit is none of its dimension."""
    return UNITS[QUANTITIES[name].dimension].get(normal_unit(unit))


def plain_name(text: str) -> str:
    """A name without case and marks."""
    return re.sub(r"[\W_]+", "", text.lower())


def quantity_of(name: str) -> tuple[str, str] | None:
    """(column, unit by the end of the name) of a logger's name; None where it is unknown."""
    stripped = name.strip()
    if stripped in QUANTITIES:
        return stripped, ""
    if (found := _by_name(stripped)) is not None:
        return found, ""
    stem, _, end = stripped.rpartition("_")
    if stem and (unit := SUFFIX_UNITS.get(end.lower())) is not None:
        found = stem if stem in QUANTITIES else _by_name(stem)
        if found is not None and to_si(found, unit) is not None:
            return found, unit
    return None


def _by_name(name: str) -> str | None:
    plain = plain_name(name)
    return next((q for q, known in QUANTITIES.items() if plain == plain_name(q) or plain in known.names), None)

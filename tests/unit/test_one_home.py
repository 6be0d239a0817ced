"""Facts of a car stand in its folder alone: no number, no name of a signal in Python, and nothing in it that is unread.

The plant is left out where it says so: the simulated car has numbers of its own.
"""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from can_dbc.codec import load_codec
from can_dbc.folder import SHIPPED, platforms
from can_dbc.quantities import COMMANDS, IMU, RECEIVER, REPORTS, TYRE
from can_dbc.units import UNITS
from hil_gateway.car.car import SECTIONS, Imu, Receiver

ROOT = Path(__file__).resolve().parents[2]
PRODUCT = tuple(
    path for package in ("hil_gateway", "estimator", "planner") for path in sorted((ROOT / package).rglob("*.py"))
)
OUTSIDE = tuple(path for path in PRODUCT if "plant" not in path.parts)

SIGNALS = {
    "imu_ax": "channel of the estimator's measurement model",
    "imu_ay": "as imu_ax",
    "current_gear": "field of a public ROS message",
    "LIVE": "the live page",
}
"""names that a DBC happens to share -> what they are here; quantities of `can_dbc/quantities.py` may be called alike"""
STATED = {"grip": "a stage of the model"}
"""constants that happen to be called as an entry of a car -> what they are"""
UNREAD = {}
"""entries that nothing reads yet -> what is assumed instead"""


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def figures(platform: str) -> Iterator[tuple[str, float]]:
    """(section.key, value) of every number of a car, as it stands and in SI."""

    def found(table: dict[str, object], at: str) -> Iterator[tuple[str, float]]:
        for key, entry in table.items():
            if isinstance(entry, dict) and "value" not in entry:
                yield from found(entry, f"{at}{key}.")
            elif isinstance(entry, dict):
                values = entry["value"] if isinstance(entry["value"], list) else [entry["value"]]
                for value in values:
                    yield at + key, float(value)
                    yield at + key, float(f"{value * UNITS[entry['unit']].factor:.6g}")

    yield from found(tomllib.loads((SHIPPED / platform / "car.toml").read_text()), "")


def telling(value: float) -> bool:
    """Whether a number is no coincidence: three digits or more."""
    return len(f"{abs(value):.5e}".partition("e")[0].rstrip("0").replace(".", "")) >= 3


def literals(path: Path) -> Iterator[tuple[int, object]]:
    return ((n.lineno, n.value) for n in ast.walk(tree(path)) if isinstance(n, ast.Constant))


def stated(path: Path) -> Iterator[tuple[int, str]]:
    """(line, name in small letters) of every constant and default that is a number."""
    for node in ast.walk(tree(path)):
        targets, value = [], None
        if isinstance(node, ast.Assign):
            targets, value = node.targets, node.value
        elif isinstance(node, ast.AnnAssign):
            targets, value = [node.target], node.value
        if isinstance(value, ast.Call):
            value = next((word.value for word in value.keywords if word.arg == "default"), None)
        number = isinstance(value, ast.Constant) and type(value.value) in {int, float}
        yield from ((node.lineno, t.id.lower()) for t in targets if number and isinstance(t, ast.Name))


def test_no_number_of_a_car_is_repeated() -> None:
    known = {
        value: f"{platform}: {key}" for platform in platforms() for key, value in figures(platform) if telling(value)
    }
    found = [
        f"{path.relative_to(ROOT)}:{line}: {value} is that of {known[float(value)]}"
        for path in OUTSIDE
        for line, value in literals(path)
        if type(value) in {int, float} and float(value) in known  # type: ignore[arg-type]  # numbers by now
    ]
    assert found == []


def test_no_constant_or_default_is_called_as_an_entry_of_a_car() -> None:
    names = {key for section in SECTIONS.values() for key in section.model_fields if len(key) > 2} - STATED.keys()
    found = [
        f"{path.relative_to(ROOT)}:{line}: {name}" for path in OUTSIDE for line, name in stated(path) if name in names
    ]
    assert found == []


OF_EVERY_CAR = {
    "PRESSED": "hydraulic brakes", "TORQUE_MAX": "a slip of a digit", "LIGHTEST": "wheels of race cars",
    "AIR_PA": "the atmosphere", "READS_PA": "the atmosphere", "MOST_PA": "race tyres",
    "SWITCH": "rounds a change of sign",
}  # fmt: skip
"""constants with a unit of mass, force, pressure, torque or power -> whose they are, if not one car's"""


def described(path: Path) -> Iterator[tuple[int, str, str]]:
    """(line, name, text after it) of every constant of a module that is a number."""
    body = tree(path).body
    for node, after in zip(body, [*body[1:], ast.Pass()], strict=True):
        if isinstance(node, ast.Assign) and any(isinstance(n, ast.Constant) for n in ast.walk(node.value)):
            said = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and str(after.value.value)
            names = [n.id for target in node.targets for n in ast.walk(target) if isinstance(n, ast.Name)]
            yield from ((node.lineno, name, said or "") for name in names)


def test_no_mass_force_pressure_or_power_of_one_car_is_a_constant() -> None:
    unit = re.compile(r"^(Pa|kPa|MPa|N|kN|N m|kg m2|kg|W|kW|V|rad at the motor)\b")
    found = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path in OUTSIDE
        for line, name, said in described(path)
        if unit.match(said) and name not in OF_EVERY_CAR
    ]
    assert found == []


def test_no_signal_of_a_dbc_is_named() -> None:
    ours = {*REPORTS, *COMMANDS, *IMU, *RECEIVER, *TYRE, *SIGNALS}
    theirs = {s.name for p in platforms() for m in load_codec(p).messages.values() for s in m.signals} - ours
    found = [
        f"{path.relative_to(ROOT)}:{line}: {value}"
        for path in PRODUCT
        for line, value in literals(path)
        if isinstance(value, str) and value in theirs
    ]
    assert found == []


def test_every_entry_of_a_car_is_read() -> None:
    text = "\n".join(path.read_text(encoding="utf-8") for path in PRODUCT)
    sections = {**SECTIONS, "imu": Imu, "receiver": Receiver}
    unread = {
        f"{section}.{key}"
        for section, model in sections.items()
        for key in model.model_fields
        if len(key) > 2 and not re.search(rf"(?<!source)\.{key}\b", text)  # B, C, D are read by their layout
    }
    assert unread == set(UNREAD), "read it, or drop it from the format"

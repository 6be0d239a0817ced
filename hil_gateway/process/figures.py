"""Numbers on their way out: rounded with their unit for people, whole and in plain types for programs.

Whatever a command prints for people goes through `figure` or `lines`; whatever it prints with --json through
`print_json`. numpy's scalars and arrays are taken by their own `tolist`, so that nothing here imports it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

DIGITS = 4
"""significant digits: more than any of our measurements has"""
UNITS = {
    "_ms": "ms",
    "_mps": "m/s",
    "_per_s": "1/s",
    "_s": "s",
    "_m": "m",
    "_mb": "MB",
    "_percent": "%",
    "peak_speed": "m/s",
}
"""how the name of a figure ends -> its unit; the first that fits"""
EXACT = 15
"""digits an integer is written with in full"""


def lap_time(seconds: float | None) -> str:
    """A lap by the estimate, which times it to 0.01 s."""
    return "-" if seconds is None else f"{seconds:.2f} s"


def figure(value: Any, unit: str = "", digits: int = DIGITS) -> str:
    """One value for people: 54.120000000000005 -> '54.12 s'; a list of them has its unit once; '-' where there is none.

    Integers and text stay as they are; a number has an exponent only where people would write one.
    """
    value = plain(value)
    if isinstance(value, list):
        return with_unit(", ".join(figure(one, "", digits) for one in value) or "none", unit if value else "")
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return with_unit(_rounded(value, digits) if isinstance(value, float) else str(value), unit)


def _rounded(value: float, digits: int) -> str:
    rounded = float(f"{value:.{digits}g}") + 0.0  # no -0
    if rounded != 0.0 and (abs(rounded) < 1e-3 or abs(rounded) >= 1e6):
        return f"{rounded:.{digits}g}"
    return f"{rounded:.{EXACT}g}"


def with_unit(text: str, unit: str) -> str:
    """'3 m'; plain text where there is no unit."""
    return f"{text} {unit}" if unit else text


def compared(ratio: float | None, less: str, more: str) -> str:
    """A ratio in words: 2.2 -> '2.2 times LESS', 0.5 -> '2 times MORE', and 'as many' within what rounding hides."""
    if ratio is None or not math.isfinite(ratio) or ratio <= 0:
        return "an unknown number of times " + less
    size = figure(max(ratio, 1.0 / ratio), digits=2)
    if size == "1":
        return "as many"
    return f"{size} times {less if ratio > 1.0 else more}"


def printable(text: str) -> str:
    """Text of others on its way to a terminal or a log: what would move the cursor or end the line, as escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def lines(tree: Mapping[str, Any], indent: str = "") -> Iterator[str]:
    """A table of figures for people, one a line, tables within it indented; the unit is what the name says."""
    width = max((len(_name(key)) for key in tree), default=0)
    for key, value in tree.items():
        if isinstance(value, Mapping) and any(isinstance(v, Mapping) for v in value.values()):
            yield f"{indent}{_name(key)}"
            yield from lines(value, indent + "  ")
        else:
            yield f"{indent}{_name(key):{width}}  {_cell(value, unit_of(key))}"


def _cell(value: Any, unit: str) -> str:
    if isinstance(value, Mapping):
        pairs = (f"{_name(k)} {figure(v, unit_of(k) or (unit if _measured(v) else ''))}" for k, v in value.items())
        return ", ".join(pairs) or "none"
    if isinstance(value, Sequence) and not isinstance(value, str) and any(isinstance(v, Mapping) for v in value):
        return "; ".join(_cell(one, unit) for one in value)
    return figure(value, unit)


def _measured(value: Any) -> bool:
    """A count within a table of times has not the unit of the times."""
    return isinstance(plain(value), float)


def unit_of(name: str) -> str:
    """Unit that the name of a figure ends with; empty where it says none."""
    return next((unit for ending, unit in UNITS.items() if str(name).endswith(ending)), "")


def _name(key: Any) -> str:
    """The name in words, without the unit that follows the figure."""
    text = str(key)
    ending = next((e for e in UNITS if e.startswith("_") and text.endswith(e) and len(text) > len(e)), "")
    return text.removesuffix("_per_s" if ending == "_per_s" else ending).replace("_", " ")


def plain(value: Any) -> Any:
    """`value` in JSON's own types, every digit kept; numbers JSON has no word for (NaN, infinity) become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, str):
        return str(value)
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(one) for one in value]
    if isinstance(value, (bool, int)) or value is None:
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    raise TypeError(f"{value!r} has no JSON type")


def print_json(value: Any) -> None:
    """One JSON object on standard output."""
    print(json.dumps(plain(value), allow_nan=False))

"""The laboratory of a checkout (`benchmarks/`) behind `hil`: what judges the product is not part of the wheel."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

from hil_gateway.process.errors import InputError

CHECKOUT = Path(__file__).resolve().parents[2]
COMMANDS = ("campaign", "verify")


def laboratory(module: str) -> Any:
    """A module of `benchmarks`, found by name: it imports all packages, which may not import it.

    Raises:
        InputError: no checkout here.
    """
    if not (CHECKOUT / "benchmarks" / "__init__.py").is_file():
        raise InputError(f"{CHECKOUT}: no benchmarks here; run this from a checkout of the project (deploy/setup.sh)")
    if str(CHECKOUT) not in sys.path:
        sys.path.append(str(CHECKOUT))
    return importlib.import_module(f"benchmarks.{module}")


def __getattr__(name: str) -> Any:
    """The app of one of `COMMANDS`."""
    if name not in COMMANDS:
        raise AttributeError(name)
    return laboratory(f"commands.{name}").app

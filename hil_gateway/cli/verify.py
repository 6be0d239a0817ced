"""`hil verify`: the verification tools of a checkout (`tests/verification`); an installed package has none."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import typer

from hil_gateway.process.errors import InputError

TESTS = Path(__file__).resolve().parents[2] / "tests"


def _tools() -> typer.Typer:
    """The command of the tools, which are found by name: they import all packages, this one may not.

    Raises:
        InputError: no checkout here.
    """
    if not (TESTS / "verification").is_dir():
        raise InputError(f"{TESTS}: no verification tools here; run `hil verify` from a checkout of the project")
    sys.path.insert(0, str(TESTS))
    app: typer.Typer = importlib.import_module("verification.command").app
    return app


app = _tools()

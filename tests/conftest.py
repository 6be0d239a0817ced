"""Shared fixtures: optional measured data, which the repository does not carry."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


def _optional(variable: str, fallback: str) -> Path:
    path = Path(os.environ.get(variable, ROOT.parent / "shared" / fallback))
    if not path.is_dir():
        pytest.skip(f"optional data absent: set {variable} to its folder")
    return path


@pytest.fixture(scope="session")
def measured_data() -> Path:
    """Folder with measured and practice drive logs; the test is skipped where it is absent."""
    return _optional("HIL_DATA", "data")


@pytest.fixture(scope="session")
def measured_tracks() -> Path:
    """Folder with tracks in the TUM convention; the test is skipped where it is absent."""
    return _optional("HIL_TRACKS", "tracks")

"""Drives that all tests of the offline chain share."""

from __future__ import annotations

from typing import Any

import pytest
from support.drives.practice_drives import shared_drives


@pytest.fixture(scope="session")
def drives(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Name -> simulated drive, see `support.drives.practice_drives.EFFECTS`."""
    return shared_drives(tmp_path_factory)

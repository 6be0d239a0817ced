"""Recorded sessions (.mcap) as drive-log columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil_gateway.session.drive_table import read_drive_table

Array = NDArray[np.float64]


def read_session(path: Path) -> tuple[dict[str, Array], list[str]]:
    """Columns of a recorded session, and notes on what was left out or damaged.

    Raises:
        InputError: no recording, or one that holds no drive.
    """
    table = read_drive_table(path)
    notes = [f"{count} rows are left out: {reason}" for reason, count in table.left_out.items() if count]
    return dict(table.columns), notes + [f"damaged: {damage}" for damage in table.damage]

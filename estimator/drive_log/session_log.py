"""Recorded sessions (.mcap) as drive-log columns."""

from __future__ import annotations

from pathlib import Path

from hil_gateway.process.arrays import Array
from hil_gateway.session.drive_table import read_drive_table


def read_session(path: Path) -> tuple[dict[str, Array], list[str]]:
    """Columns of a recorded session, and notes on what was left out or damaged.

    Raises:
        InputError: no recording, or one that holds no drive.
    """
    table = read_drive_table(path)
    notes = [f"{count} rows are left out: {reason}" for reason, count in table.left_out.items() if count]
    return dict(table.columns), notes + [f"damaged: {damage}" for damage in table.damage]

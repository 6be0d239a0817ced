"""Session -> drive log as CSV or Parquet, or raw frames as a candump log."""

from __future__ import annotations

import csv
from pathlib import Path

from hil_gateway.can_link import EXTENDED_ID, Frame
from hil_gateway.clock import NS_PER_S
from hil_gateway.errors import InputError
from hil_gateway.session.drive_table import as_rows, read_drive_table
from hil_gateway.session.format import CAN_TOPIC, unpack_frame
from hil_gateway.session.reader import SessionReader

ERROR_FLAG = 0x20000000


def export_csv(source: Path, target: Path) -> int:
    """Drive log as CSV; returns the number of rows. Numbers keep every digit."""
    columns = read_drive_table(source).columns
    with _create(target).open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows([repr(float(value)) for value in row] for row in as_rows(columns))
    return len(columns["t"])


def export_parquet(source: Path, target: Path) -> int:
    """Drive log as Parquet; returns the number of rows.

    Raises:
        InputError: the optional package is missing.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise InputError("Parquet needs the package pyarrow; install hil-gateway[parquet]") from None
    columns = read_drive_table(source).columns
    pq.write_table(pa.table(columns), _create(target))
    return len(columns["t"])


def export_candump(source: Path, target: Path, channel: str = "can0") -> int:
    """Raw frames as `candump -l` writes them; returns their number."""
    count = 0
    with _create(target).open("w") as file:
        for item in SessionReader(source).items():
            if item.topic != CAN_TOPIC:
                continue
            frame = unpack_frame(item.data)
            seconds, rest = divmod(frame.stamp_ns, NS_PER_S)
            file.write(f"({seconds}.{rest // 1000:06d}) {channel} {_number(frame)}#{frame.data.hex().upper()}\n")
            count += 1
    return count


def _number(frame: Frame) -> str:
    """Identifier as candump writes it: three digits, eight for extended and error frames."""
    if frame.is_error:
        return f"{frame.id | ERROR_FLAG:08X}"
    return f"{frame.id & ~EXTENDED_ID:08X}" if frame.id & EXTENDED_ID else f"{frame.id:03X}"


def _create(target: Path) -> Path:
    """The file, once it is known that it can be written."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        target.touch()
    except OSError as error:
        raise InputError(f"{target}: cannot write: {error.strerror}") from None
    return target


EXPORTS = {"csv": export_csv, "parquet": export_parquet, "candump": export_candump}
"""format -> function (session, file) -> number of rows or frames"""

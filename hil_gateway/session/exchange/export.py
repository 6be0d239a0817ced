"""Session -> drive log as CSV or Parquet, or raw frames as a candump log."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from hil_gateway.process.errors import InputError
from hil_gateway.session.drive_table import DriveTable, as_rows, read_drive_table
from hil_gateway.session.files.format import CAN_TOPIC, METADATA_SESSION, named, unpack_frame
from hil_gateway.session.files.output import output_file
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.logs.candump import format_line

UNKNOWN_CHANNEL = "can0"
"""where the session came over no interface with a name"""


@dataclass(frozen=True)
class Exported:
    """What was written, and what was not."""

    rows: int
    """rows or frames"""
    left_out: Mapping[str, int]
    """rows that could not be used, by reason"""
    damage: tuple[str, ...]
    """places of the recording that could not be read"""


def export_csv(source: Path, target: Path) -> Exported:
    """Drive log as CSV. Numbers keep every digit."""
    table = read_drive_table(source)
    with output_file(target, source) as path, path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(table.columns)
        writer.writerows([repr(float(value)) for value in row] for row in as_rows(table.columns))
    return _exported(table)


def export_parquet(source: Path, target: Path) -> Exported:
    """Drive log as Parquet.

    Raises:
        InputError: the optional package is missing.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise InputError("Parquet needs the package pyarrow; install hil-gateway[parquet]") from None
    table = read_drive_table(source)
    with output_file(target, source) as path:
        pq.write_table(pa.table(table.columns), path)
    return _exported(table)


def _exported(table: DriveTable) -> Exported:
    return Exported(len(table.columns["t"]), table.left_out, table.damage)


def export_candump(source: Path, target: Path) -> Exported:
    """Raw frames as `candump -l` writes them, under the name of the interface they came over."""
    count, reader = 0, SessionReader(source)
    with output_file(target, source) as path, path.open("w") as file, named(source):
        for item in reader.items():
            if item.topic == CAN_TOPIC:
                channel = reader.metadata.get(METADATA_SESSION, {}).get("channel") or UNKNOWN_CHANNEL
                file.write(f"{format_line(unpack_frame(item.data), channel)}\n")
                count += 1
    return Exported(count, {}, tuple(map(str, reader.damage)))

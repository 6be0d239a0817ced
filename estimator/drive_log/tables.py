"""Files of numbers of any kind as one table: told by what they hold, whatever their name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimator.drive_log import vbo
from estimator.drive_log.bag.assembly import read_bag_drive
from estimator.drive_log.text_table import WrittenTable, read_text_table
from hil_gateway.process.errors import InputError
from hil_gateway.session.logs.raw_bag import is_mcap, is_recording, is_sqlite
from hil_gateway.session.logs.source import Source


@dataclass(frozen=True)
class TableFormat:
    """One kind of file."""

    recognises: Callable[[Source], bool]
    read: Callable[[Path], WrittenTable]


def _is_parquet(source: Source) -> bool:
    return source.head.startswith(b"PAR1")


def _read_parquet(path: Path) -> WrittenTable:
    """Numeric columns; times become seconds, and what is no number is left out."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise InputError("Parquet needs the package pyarrow; install hil-gateway[parquet]") from None
    try:
        table = pq.read_table(path)
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path}: not a readable Parquet file: {' '.join(str(error).split())[:200]}") from None
    names, columns, skipped = list[str](), [], list[str]()
    for field, column in zip(table.schema, table.columns, strict=True):
        kind = field.type
        if pa.types.is_timestamp(kind):
            stamps = column.cast(pa.timestamp("ns")).cast(pa.int64())
            columns.append(1e-9 * np.asarray(stamps.to_numpy(), float))
        elif pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind):
            columns.append(np.asarray(column.cast(pa.float64()).to_numpy(), float))
        else:
            skipped.append(field.name)
            continue
        names.append(field.name)
    if not columns:
        raise InputError(f"{path}: no column of numbers")
    notes = (f"columns without numbers are left out: {', '.join(skipped)}",) if skipped else ()
    lines = np.arange(1, len(columns[0]) + 1, dtype=np.int64)
    return WrittenTable(tuple(names), ("",) * len(names), np.column_stack(columns), lines, 0, notes)


def is_bag(path: Path) -> bool:
    """Whether a file or folder is a ROS 2 bag, and no recording of ours."""
    return path.is_dir() or _is_bag(Source(path))


def _is_bag(source: Source) -> bool:
    return is_sqlite(source) or (is_mcap(source) and not is_recording(source))


FORMATS = (
    TableFormat(_is_bag, read_bag_drive),
    TableFormat(_is_parquet, _read_parquet),
    TableFormat(vbo.recognises, vbo.read_vbo),
)
"""before plain text; a further format is one module and one line here"""


def read_table(path: Path) -> WrittenTable:
    """Columns as written, of any kind of file.

    Raises:
        InputError: unreadable, or a place that is wrong.
    """
    if path.is_dir():
        return read_bag_drive(path)
    source = Source(path)
    found = next((one for one in FORMATS if one.recognises(source)), None)
    return read_text_table(path) if found is None else found.read(path)

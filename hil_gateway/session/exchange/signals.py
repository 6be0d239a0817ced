"""Session -> every decoded CAN signal as a column, 100 rows a second: each holds its newest value."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from can_dbc.codec import Codec, Fault
from hil_gateway.process.arrays import Array
from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.session.exchange.export import Exported
from hil_gateway.session.files.configuration import recorded_config
from hil_gateway.session.files.format import CAN_TOPIC, named, unpack_frame
from hil_gateway.session.files.output import output_file
from hil_gateway.session.files.reader import SessionReader

STEP_NS = NS_PER_S // 100
"""the quickest messages of the car come this often"""
Samples = dict[int, tuple[list[int], list[list[float]]]]
"""identifier -> stamps (ns), rows of values"""


def export_signals(source: Path, target: Path) -> Exported:
    """Columns `t` (s since the first frame) and `message.signal [unit]` as CSV, or Parquet where `target` ends so.

    A signal is NaN before its first frame. Frames the DBC does not know are counted by identifier.

    Raises:
        InputError: no recording, no frames the DBC knows, `target` cannot be written, pyarrow missing.
    """
    codec, left_out, reader = (
        recorded_config(source).car.codec,
        dict[str, int](),
        SessionReader(source, frozenset({CAN_TOPIC})),
    )
    samples: Samples = {}
    with named(source):
        for item in reader.items():
            frame = unpack_frame(item.data)
            values = codec.decode_raw(frame.id, frame.data)
            if frame.is_error or isinstance(values, Fault):
                reason = "error frame" if frame.is_error else str(values)
                left_out[reason] = left_out.get(reason, 0) + 1
                continue
            stamps, rows = samples.setdefault(frame.id, ([], []))
            stamps.append(frame.stamp_ns)
            rows.append(list(values.values()))
    if not samples:
        raise InputError(f"{source}: holds no frame the DBC knows")
    columns = _columns(samples, codec)
    with output_file(target, source) as path:
        if target.suffix == ".parquet":
            _write_parquet(columns, path)
        else:
            _write_csv(columns, path)
    return Exported(len(columns["t"]), left_out, tuple(map(str, reader.damage)))


def _columns(samples: Samples, codec: Codec) -> dict[str, Array]:
    """Every signal on one time grid, its newest value held."""
    first = min(stamps[0] for stamps, _ in samples.values())
    last = max(stamps[-1] for stamps, _ in samples.values())
    grid = np.arange(first, last + 1, STEP_NS)
    columns: dict[str, Array] = {"t": (grid - first) / NS_PER_S}
    for frame_id, (stamps, rows) in sorted(samples.items()):
        message, table = codec.by_id[frame_id], np.array(rows)
        index = np.searchsorted(np.array(stamps), grid, side="right") - 1
        for number, signal in enumerate(message.signals):
            held = np.where(index >= 0, table[np.maximum(index, 0), number], np.nan)
            unit = f" [{signal.unit}]" if signal.unit else ""
            columns[f"{message.name}.{signal.name}{unit}"] = held
    return columns


def _write_csv(columns: dict[str, Array], path: Path) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows([f"{value:.10g}" for value in row] for row in np.column_stack(list(columns.values())))


def _write_parquet(columns: dict[str, Array], path: Path) -> None:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise InputError("Parquet needs the package pyarrow; install hil-gateway[parquet]") from None
    pq.write_table(pa.table(columns), path)

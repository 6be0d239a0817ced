"""What a session can be exported to, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from hil_gateway.session.exchange.export import Exported, export_candump, export_csv, export_parquet
from hil_gateway.session.exchange.motec import export_motec
from hil_gateway.session.exchange.ros2 import export_ros2
from hil_gateway.session.exchange.signals import export_signals

EXPORTS: Mapping[str, Callable[[Path, Path], Exported]] = {
    "csv": export_csv,
    "parquet": export_parquet,
    "candump": export_candump,
    "signals": export_signals,
    "motec": export_motec,
    "ros2": export_ros2,
}
"""format -> function (session, file)"""

"""Logs of frames as tables, with a header that names the columns: GVRET (SavvyCAN), python-can, CSS, Kvaser.

Read by the names in the header; python-can reads none of them but its own.
"""

from __future__ import annotations

import base64
import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from hil_gateway.process.clock import NS_PER_S
from hil_gateway.process.errors import InputError
from hil_gateway.session.logs.entry import (
    CUT_OFF,
    LONGER_FRAME,
    REMOTE_REQUEST,
    Entry,
    data_frame,
    error_frame,
    nanoseconds,
)
from hil_gateway.session.logs.source import Source
from hil_gateway.session.logs.wall_clock import parse_date

NAMES: Mapping[str, tuple[str, ...]] = {
    "time": ("time stamp", "timestamp", "timestampepoch", "time", "time (s)", "time[s]", "abs time"),
    "id": ("id", "arbitration_id", "can id", "canid", "can_id", "identifier", "arbitration id"),
    "extended": ("extended", "ide", "ext", "is_extended"),
    "bus": ("bus", "buschannel", "channel", "chn"),
    "length": ("len", "length", "datalength", "dlc"),
    "data": ("data", "databytes", "data bytes"),
    "remote": ("remote", "rtr", "is_remote"),
    "error": ("error", "is_error", "err"),
    "longer": ("edl", "fd", "is_fd"),
}  # fmt: skip
"""what a column is -> the names it goes by"""
_BYTE = re.compile(r"(?:d|data|b|byte|data\s?byte)\s?_?(\d{1,2})", re.IGNORECASE)
TRUE = {"1", "true", "yes", "x", "ext", "extended"}
MICROSECONDS = 1000
"""ns of a time without a decimal point: GVRET counts microseconds since its start"""


@dataclass(frozen=True)
class _Header:
    """Where each column is."""

    separator: str
    at: Mapping[str, int]
    bytes_at: tuple[int, ...]
    base64: bool

    def cell(self, cells: Sequence[str], name: str) -> str:
        """Content of a column, empty where there is none."""
        at = self.at.get(name, len(cells))
        return cells[at].strip() if at < len(cells) else ""

    def flag(self, cells: Sequence[str], name: str) -> bool:
        """Whether a column says yes."""
        return self.cell(cells, name).lower() in TRUE


def _header(line: str) -> _Header | None:
    separator = max(",;\t", key=line.count)
    names = [name.strip().strip('"').lower() for name in line.split(separator)]
    known = {what: next((n for n in spellings if n in names), "") for what, spellings in NAMES.items()}
    at = {what: names.index(name) for what, name in known.items() if name}
    numbered = sorted((int(found[1]), i) for i, name in enumerate(names) if (found := _BYTE.fullmatch(name)))
    if not {"time", "id"} <= at.keys() or not (numbered or "data" in at):
        return None
    return _Header(separator, at, tuple(i for _, i in numbered), "arbitration_id" in names and not numbered)


def recognises(source: Source) -> bool:
    """Whether the first line names the columns of frames."""
    return bool(source.first_lines) and _header(source.first_lines[0]) is not None


def read_table(source: Source) -> Iterator[Entry]:
    """Entries of a log.

    Raises:
        InputError: a row that is no frame, with its number.
    """
    header: _Header | None = None
    for line in source.lines():
        if header is None:
            header = _header(line.text)
            continue
        if not line.text.strip():
            continue
        try:
            yield _entry(header, next(csv.reader([line.text], delimiter=header.separator)))
        except (ValueError, IndexError) as error:
            if not line.ended:
                yield CUT_OFF
                return
            raise InputError(f"{source.path}: row {line.number}: {error}: not a frame") from None


def _entry(header: _Header, cells: Sequence[str]) -> Entry:
    channel = header.cell(cells, "bus")
    channel = f"can{channel}" if channel.isdigit() else channel or "can0"
    stamp_ns = _time(header.cell(cells, "time"))
    if header.flag(cells, "error"):
        return error_frame(channel, stamp_ns)
    if header.flag(cells, "remote"):
        return REMOTE_REQUEST
    number, data = header.cell(cells, "id"), _data(header, cells)
    if header.flag(cells, "longer") or len(data) > 8:
        return LONGER_FRAME
    value = int(number, 16)
    extended = header.flag(cells, "extended") if "extended" in header.at else value > 0x7FF
    return data_frame(channel, value, data, stamp_ns, extended=extended)


def _data(header: _Header, cells: Sequence[str]) -> bytes:
    length = header.cell(cells, "length")
    wanted = int(length) if length else None
    if header.bytes_at:
        found = bytes(int(cells[i], 16) for i in header.bytes_at if i < len(cells) and cells[i].strip())
    elif header.base64:
        found = base64.b64decode(header.cell(cells, "data"), validate=True)
    else:
        found = bytes.fromhex(re.sub(r"\s|0x", "", header.cell(cells, "data")))
    if wanted is not None and len(found) < wanted <= 8:
        raise ValueError(f"{len(found)} bytes of a frame of {wanted}")
    return found[:wanted]


def _time(text: str) -> int:
    """ns of seconds, of microseconds since the logger's start, or of a date."""
    if text.isdigit():
        return nanoseconds(text, MICROSECONDS)
    if (date_ns := parse_date(text)) is not None:
        return date_ns
    return nanoseconds(text, NS_PER_S)

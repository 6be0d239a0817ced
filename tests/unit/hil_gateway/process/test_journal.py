"""What a process says costs it nothing: on a full disk, where nobody reads, and in a terminal that is held."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hil_gateway.process.journal import HELD

SAYS = """
import logging
from hil_gateway.process.journal import Journal
with Journal() as journal:
    logging.getLogger("bus").warning("slow since %s", "noon")
    for number in range(MANY):
        journal.say(f"line {number}")
print("done")
"""


def said(many: int, stderr: int) -> str:
    """Standard output of a process that says `many` lines after a record of the standard log."""
    command = [sys.executable, "-c", f"MANY = {many}\n{SAYS}"]
    return subprocess.run(command, stdout=subprocess.PIPE, stderr=stderr, text=True, check=True).stdout


def test_lines_are_written_in_order_and_the_last_ones_at_the_end(tmp_path: Path) -> None:
    with (tmp_path / "log").open("w+") as file:
        said(20, file.fileno())
        file.seek(0)
        assert file.read().splitlines() == ["slow since noon", *(f"line {number}" for number in range(20))]


def test_a_full_disk_ends_nothing() -> None:
    with Path("/dev/full").open("w") as full:
        assert said(20, full.fileno()) == "done\n"


def test_a_reader_that_is_gone_ends_nothing() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    assert said(20, writer) == "done\n"
    os.close(writer)


@pytest.mark.parametrize("many", [20, 2 * HELD])
def test_a_terminal_that_is_held_holds_nothing_up(many: int) -> None:
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    with pytest.raises(BlockingIOError):
        while True:
            os.write(writer, bytes(4096))
    os.set_blocking(writer, True)
    assert said(many, writer) == "done\n"
    os.close(reader)
    os.close(writer)

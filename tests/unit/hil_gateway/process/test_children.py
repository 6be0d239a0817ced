"""Processes that share work end with the command that started them, quietly, and with what was under way."""

from __future__ import annotations

import os
import signal
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from hil_gateway.process.children import pool


def never_ends(told: Path) -> None:
    told.write_text(str(os.getpid()))
    time.sleep(3600.0)


def pid_in(told: Path) -> int:
    while not (told.exists() and told.read_text()):
        time.sleep(0.01)
    return int(told.read_text())


def test_ctrl_c_ends_them_without_a_word(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with pool(1) as executor:
        future = executor.submit(never_ends, tmp_path / "pid")
        os.kill(pid_in(tmp_path / "pid"), signal.SIGINT)
        with pytest.raises(BrokenProcessPool):
            future.result(timeout=60.0)
    assert capfd.readouterr() == ("", "")


def test_ctrl_c_while_they_load_is_held_back_until_they_can_end_quietly(capfd: pytest.CaptureFixture[str]) -> None:
    with pool(1) as executor:
        future = executor.submit(os.getpid)
        (child,) = executor._processes
        os.kill(child, signal.SIGINT)
        with pytest.raises(BrokenProcessPool):
            future.result(timeout=60.0)
    assert capfd.readouterr() == ("", "")


def test_what_is_under_way_is_given_up_by_an_interrupt(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), pool(1) as executor:
        executor.submit(never_ends, tmp_path / "pid")
        pid = pid_in(tmp_path / "pid")
        raise KeyboardInterrupt
    assert not Path(f"/proc/{pid}").exists()

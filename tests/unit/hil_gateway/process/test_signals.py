"""Ctrl-C and SIGTERM end a command in order, without a traceback, with the exit code a shell expects."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from hil_gateway.process.lifecycle import StopRequest

WHILE_LOADING = """
import os, signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "typer":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
from hil_gateway.__main__ import run
sys.argv = ["hil", "--help"]
run()
"""
AT_WORK = """
import os, signal, sys, typer
import hil_gateway.cli.doctor as doctor
from hil_gateway.process import lifecycle
def work(*_):
    if AS == "ended in order":
        stopping = lifecycle.StopRequest()
        os.kill(os.getpid(), NUMBER)
        raise typer.Exit(128 + stopping.signal)
    try:
        os.kill(os.getpid(), signal.SIGINT)
        signal.pause()
    except KeyboardInterrupt as error:
        if "turned" in AS:  # as pydantic does while it builds a model
            raise ValueError("SchemaError: KeyboardInterrupt") from error
        if AS == "raised":
            raise
    if AS == "swallowed once":
        signal.pause()
    while True:  # as IPOPT does
        try:
            signal.pause()
        except KeyboardInterrupt:
            pass
doctor.findings = work
from hil_gateway.__main__ import run
sys.argv[1:] = ["doctor"]
run()
"""


@pytest.mark.parametrize(
    ("code", "ended"),
    [
        (WHILE_LOADING, -signal.SIGINT),
        *((f"AS = '{how}'\n{AT_WORK}", 130) for how in ("raised", "turned", "swallowed once")),
        (f"AS = 'swallowed'\n{AT_WORK}", -signal.SIGINT),
        *((f"AS, NUMBER = 'ended in order', {n}\n{AT_WORK}", 128 + n) for n in (signal.SIGINT, signal.SIGTERM)),
    ],
)
def test_ctrl_c_is_no_traceback_at_any_moment(code: str, ended: int) -> None:
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (result.returncode, result.stderr, result.stdout) == (ended, "", "")


def test_a_request_says_which_signal_it_was_and_can_be_given_back() -> None:
    before = signal.getsignal(signal.SIGTERM)
    stopping = StopRequest()
    try:
        assert not stopping()
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGINT)
        assert stopping()
        assert (stopping.signal, stopping.count) == (signal.SIGTERM, 2)
    finally:
        stopping.release()
    assert signal.getsignal(signal.SIGTERM) is before

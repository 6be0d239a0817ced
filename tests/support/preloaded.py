"""`hil ARGUMENTS` in a fork of a clean process that has imported everything: importing is most of a wrong call."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
from pathlib import Path

from hil_gateway.cli.main import COMMANDS, main

LIMIT_S = 120.0
"""of one call, on a machine with other work"""
FURTHER = ("hil_gateway.demo.drive", "benchmarks.campaign.closed", __name__)
"""what commands import once they are called"""


def hil_preloaded(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """What the call says and how it ends; `folder` takes what it prints. The working folder is that of the caller."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([*{module.split(":")[0] for module, _ in COMMANDS.values()}, *FURTHER])
    paths = [folder / name for name in ("out", "err")]
    call = context.Process(target=_become_hil, args=(arguments, paths))
    call.start()
    call.join(LIMIT_S)
    call.kill()
    call.join()
    assert call.exitcode is not None
    return subprocess.CompletedProcess(arguments, call.exitcode, *(path.read_text() for path in paths))


def _become_hil(arguments: tuple[str, ...], paths: list[Path]) -> None:
    sys.argv = ["hil", *arguments]
    for path, number in zip(paths, (1, 2), strict=True):
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(descriptor, number)
    sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
    main()

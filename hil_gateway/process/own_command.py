"""A command of the project run by another: the seam over which a package uses one that it may not import."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

TIMEOUT_S = 3600.0
"""of a recording of hours"""


@dataclass(frozen=True)
class CommandResult:
    """What a command of the project said: its JSON, or why there is none."""

    content: dict[str, Any]
    reason: str = ""


def ask(arguments: Sequence[str]) -> CommandResult:
    """Run `hil ARGUMENTS --json`; a failure becomes a reason. On a terminal its progress shows."""
    command = [sys.executable, "-m", "hil_gateway", *arguments, "--json"]
    try:
        stderr = None if sys.stderr.isatty() else subprocess.PIPE
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=stderr, text=True, timeout=TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        return CommandResult({}, f"`hil {arguments[0]}` took longer than {TIMEOUT_S:g} s")
    if done.returncode != 0:
        lines = (done.stderr or "").strip().splitlines()
        return CommandResult({}, lines[-1].removeprefix("hil: ") if lines else f"`hil {arguments[0]}` failed")
    return CommandResult(json.loads(done.stdout))

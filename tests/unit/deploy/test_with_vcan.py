"""`deploy/with-vcan`: same directory, environment, output and exit code, whichever CAN it finds."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[3] / "deploy" / "with-vcan"


def run(*command: str, folder: Path | None = None, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **variables}
    return subprocess.run(
        [SCRIPT, *command], capture_output=True, text=True, env=environment, cwd=folder, timeout=120, check=False
    )


def test_without_a_command_it_explains_itself() -> None:
    result = run()
    assert result.returncode == 2
    assert "deploy/with-vcan CMD" in result.stderr + result.stdout


def test_where_neither_kind_can_be_had_it_says_so_and_what_to_install(tmp_path: Path) -> None:
    """A search path without `ip`, `sudo` and `linux.uml`."""
    for name in ("cat", "id", "find", "sort", "tail", "dirname", "bash"):
        (tmp_path / name).symlink_to(Path("/usr/bin") / name)
    result = run("true", PATH=str(tmp_path), HIL_VCAN="uml")
    assert result.returncode == 2
    assert "apt-get install user-mode-linux" in result.stderr


@pytest.mark.slow
def test_exit_code_output_environment_and_directory_pass_through(tmp_path: Path) -> None:
    if run("--which").returncode:
        pytest.skip("neither a vcan interface nor user-mode Linux here: apt-get install user-mode-linux")
    script = 'echo "$WORD"; pwd; echo problem >&2; test -d /sys/class/net/vcan0 && (sleep 60 &); exit 7'
    result = run("bash", "-c", script, folder=tmp_path, WORD="two words; $HOME 'x'")
    assert result.returncode == 7
    assert result.stdout.splitlines() == ["two words; $HOME 'x'", str(tmp_path)]
    assert result.stderr.splitlines() == ["problem"]

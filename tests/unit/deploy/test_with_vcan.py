"""`deploy/with-vcan`: same directory, environment, output and exit code, whichever CAN it finds."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[3] / "deploy" / "with-vcan"


def run(*command: str, folder: Path | None = None, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **variables}
    return subprocess.run(
        [SCRIPT, *command], capture_output=True, text=True, env=environment, cwd=folder, timeout=120, check=False
    )


BASICS = ("cat", "id", "find", "sort", "tail", "dirname", "bash")
TOOLS = ("ip", "python3", "mktemp", "rm", "df", "numfmt", "env", "grep", "uname", "sha256sum", "cut", "sh")


def restricted_path(folder: Path) -> Path:
    """A search path without `ip`, `sudo` and `linux.uml`."""
    folder.mkdir(exist_ok=True)
    for name in BASICS:
        (folder / name).symlink_to(Path("/usr/bin") / name)
    return folder


def test_without_a_command_it_explains_itself() -> None:
    result = run()
    assert result.returncode == 2
    assert "deploy/with-vcan CMD" in result.stderr + result.stdout


def test_where_neither_kind_can_be_had_it_says_so_and_what_to_install(tmp_path: Path) -> None:
    path = restricted_path(tmp_path)
    for command in ("true", "--which"):
        result = run(command, PATH=str(path), HIL_VCAN="uml")
        assert result.returncode == 2
        assert "apt-get install user-mode-linux" in result.stderr
        assert len(result.stderr.splitlines()) == 1


def test_which_answers_from_a_boot_and_not_from_files_being_there(tmp_path: Path) -> None:
    """A `linux.uml` that dies at once is there, and does not run; its last words are the reason."""
    path = restricted_path(tmp_path / "bin")
    kernel = path / "linux.uml"
    kernel.write_text("#!/bin/sh\necho 'no room on this machine' >&2\nexit 1\n")
    kernel.chmod(0o755)
    for name in TOOLS:
        (path / name).symlink_to(shutil.which(name) or name)
    modules = tmp_path / "modules.dep"
    modules.touch()
    (path / "find").unlink()
    (path / "find").write_text(f"#!/bin/sh\necho {modules}\n")
    (path / "find").chmod(0o755)
    result = run("--which", PATH=str(path), HIL_VCAN="uml", CC="none", XDG_CACHE_HOME=str(tmp_path / "cache"))
    assert result.returncode == 2
    assert result.stderr.rstrip().endswith("user-mode Linux does not run: no room on this machine")
    assert not list(tmp_path.glob("cache/**/uml-boots-*"))


@pytest.mark.slow
def test_exit_code_output_environment_and_directory_pass_through_side_by_side(tmp_path: Path) -> None:
    which_or_skip()
    script = 'echo "$WORD"; pwd; echo problem >&2; sleep 1; test -d /sys/class/net/vcan0 && (sleep 60 &); exit $CODE'
    word = "two words; $HOME 'x'"
    with ThreadPoolExecutor() as pool:
        results = list(pool.map(lambda code: run("bash", "-c", script, folder=tmp_path, WORD=word, CODE=code), "34"))
    assert [result.returncode for result in results] == [3, 4]
    for result in results:
        assert result.stdout.splitlines() == [word, str(tmp_path)]
        assert result.stderr.splitlines() == ["problem"]


@pytest.mark.slow
def test_numbers_of_a_guest_are_those_of_the_host() -> None:
    """Vector registers survive the guest's switches between its processes: residual of an inverted 200 x 200 matrix."""
    which_or_skip()
    code = "import numpy as np; a = np.random.default_rng(1).normal(size=(200, 200));"
    # one write a process: number and newline apart, another process may come between them
    code += "print(f'{abs(a @ np.linalg.inv(a) - np.eye(200)).max()}\\n', end='')"
    crowd = 'for _ in 1 2 3; do "$0" -c "$1" & done; wait'
    result = run("bash", "-c", crowd, sys.executable, code, OMP_NUM_THREADS="1")
    assert result.returncode == 0
    residuals = [float(line) for line in result.stdout.split()]
    assert len(residuals) == 3
    # 200 * 2.2e-16 * condition number (about 1e3)
    assert max(residuals) < 1e-10


def which_or_skip() -> None:
    if (result := run("--which")).returncode:
        pytest.skip(result.stderr.strip())

"""Which interpreter the set-up takes."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

USED = [
    "bash",
    "cat",
    "dirname",
    "grep",
    "id",
    "mktemp",
    "readlink",
    "rm",
    "sed",
    "sha256sum",
    "sort",
    "tail",
    "xargs",
]
SETUP = Path(__file__).resolve().parents[3] / "deploy/setup.sh"


def interpreter(folder: Path, body: str) -> Path:
    """A program named as one that fits, which says `body` when it is measured and makes no .venv."""
    folder.mkdir()
    program = folder / "python3.11"
    program.write_text(f'#!/bin/sh\ncase "$*" in *timeit*) {body};; *venv*) echo "$0" >&2; exit 1;; esac\n')
    program.chmod(0o755)
    return program


def taken(tmp_path: Path, *programs: Path) -> str:
    """What the set-up of a fresh clone says it makes its .venv with, without uv."""
    clone = tmp_path / "clone"
    (clone / "deploy").mkdir(parents=True)
    shutil.copy(SETUP, clone / "deploy")
    for name in ("requirements.lock", "pyproject.toml"):
        (clone / name).touch()
    tools = tmp_path / "tools"
    tools.mkdir()
    for name in USED:
        (tools / name).symlink_to(shutil.which(name) or pytest.skip(f"no {name}"))
    path = ":".join([*(str(program.parent) for program in programs), str(tools)])
    result = subprocess.run(
        [clone / "deploy/setup.sh"], env=os.environ | {"PATH": path}, capture_output=True, text=True, check=False
    )
    assert result.returncode == 1, result.stderr
    return result.stderr.splitlines()[-1].rpartition(": ")[2]


def test_the_quickest_interpreter_of_a_version_is_taken_wherever_it_is_on_the_path(tmp_path: Path) -> None:
    slow, quick = interpreter(tmp_path / "slow", "echo 4500"), interpreter(tmp_path / "quick", "echo 990")
    assert taken(tmp_path, slow, quick) == str(quick)


def test_an_interpreter_that_can_make_no_venv_is_not_taken_before_one_that_can(tmp_path: Path) -> None:
    bare, whole = interpreter(tmp_path / "bare", "exit 1"), interpreter(tmp_path / "whole", "echo 4500")
    assert taken(tmp_path, bare, whole) == str(whole)

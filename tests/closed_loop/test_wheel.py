"""The wheel, installed outside the checkout: it brings what `hil` needs and drives from an empty folder.

Its own virtual environment sees the dependencies installed here by a path entry, and nothing of the checkout: entries
of entries are not followed, so that the editable install beside them stays inactive.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("can_dbc", "hil_gateway", "estimator", "planner")
BUILD = "import sys; from setuptools.build_meta import build_wheel; build_wheel(sys.argv[1])"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("ensurepip") is None, reason="needs venv: apt-get install python3-venv"),
]


@dataclass(frozen=True)
class Installed:
    """A clean environment with the wheel in it."""

    wheel: Path
    folder: Path

    @property
    def python(self) -> Path:
        return self.folder / "bin" / "python"

    @property
    def packages(self) -> Path:
        return self.folder / "lib" / f"python{sysconfig.get_python_version()}" / "site-packages"

    def run(self, *command: str | Path, cwd: Path, timeout_s: float = 120.0) -> subprocess.CompletedProcess[str]:
        """A command without anything of ours in its environment but the cache of compiled functions."""
        kept = {k: v for k, v in os.environ.items() if k in {"HOME", "XDG_CACHE_HOME", "LANG", "TMPDIR"}}
        environment = {**kept, "PATH": f"{self.folder / 'bin'}:/usr/bin:/bin", "OMP_NUM_THREADS": "1"}
        return subprocess.run(
            command, capture_output=True, text=True, cwd=cwd, env=environment, timeout=timeout_s, check=False
        )


def build(folder: Path) -> Path:
    """The wheel of a copy of the sources, so that nothing built before can lie in it."""
    source = folder / "source"
    for name in PACKAGES:
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    (source / "docs").mkdir()
    for name in ("pyproject.toml", "docs/package.md", "LICENSE"):
        shutil.copy(ROOT / name, source / name)
    command = [sys.executable, "-c", BUILD, str(folder)]
    result = subprocess.run(command, cwd=source, capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 0, result.stderr
    shutil.rmtree(source)
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    wheel = build(tmp_path_factory.mktemp("wheel"))
    clean = Installed(wheel, tmp_path_factory.mktemp("clean") / "venv")
    subprocess.run([sys.executable, "-m", "venv", clean.folder], check=True, timeout=120)
    clean.packages.joinpath("dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    command = (clean.python, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--force-reinstall", wheel)
    result = clean.run(*command, cwd=wheel.parent)
    assert result.returncode == 0, result.stderr
    return clean


@pytest.fixture
def empty(tmp_path: Path) -> Path:
    folder = tmp_path / "empty"
    folder.mkdir()
    return folder


def test_every_package_comes_from_the_wheel(installed: Installed, empty: Path) -> None:
    code = f"import {', '.join(PACKAGES)}; print(*(p.__file__ for p in ({', '.join(PACKAGES)})), sep='\\n')"
    result = installed.run(installed.python, "-c", code, cwd=empty)
    assert result.stdout.splitlines() == [str(installed.packages / name / "__init__.py") for name in PACKAGES]


@pytest.mark.long
def test_wheel_drives_from_an_empty_folder(installed: Installed, empty: Path) -> None:
    result = installed.run("hil", "demo", "--seconds", "8", "--headless", "--json", cwd=empty, timeout_s=400)
    assert result.returncode == 0, result.stderr
    summary = json.loads(result.stdout)
    assert summary["ok"]
    assert str(ROOT) not in result.stdout + result.stderr
    recording = next(empty.rglob("*.mcap"))
    info = json.loads(installed.run("hil", "session", "info", "--json", recording, cwd=empty).stdout)
    assert info["duration_s"] > 8.0


def test_doctor_finds_the_data_of_the_package_and_misses_what_is_gone(installed: Installed, empty: Path) -> None:
    def package_data() -> dict[str, object]:
        report = json.loads(installed.run("hil", "doctor", "--json", cwd=empty).stdout)
        return next(check for check in report["checks"] if check["name"] == "package data") | {"all": report["ok"]}

    assert package_data()["ok"]
    track = installed.packages / "hil_gateway" / "data" / "tracks" / "road_course.toml"
    text = track.read_text()
    track.unlink()
    try:
        found = package_data()
    finally:
        track.write_text(text)
    assert (found["ok"], found["all"]) == (False, False)
    assert "hil_gateway/data/tracks/road_course.toml" in str(found["detail"])


def test_templates_can_be_had_without_the_checkout(installed: Installed, empty: Path) -> None:
    result = installed.run("hil", "doctor", "--template", "av24.toml", cwd=empty)
    assert result.stdout == (ROOT / "deploy" / "av24.toml").read_text()
    (empty / "car.toml").write_text(result.stdout)
    shown = installed.run("hil", "config", "show", "--config", "car.toml", "--json", cwd=empty)
    table = {row["key"]: row for row in json.loads(shown.stdout)["settings"]}
    assert (table["gateway.mode"]["value"], table["gateway.mode"]["origin"]) == ("listen", "car.toml")


def test_page_of_the_package_names_authors_and_version_and_has_no_link_that_leads_nowhere(installed: Installed) -> None:
    with ZipFile(installed.wheel) as archive:
        page = archive.read(next(n for n in archive.namelist() if n.endswith("METADATA"))).decode()
    head, _, body = page.partition("\n\n")
    author = re.search(r"^Author: (.+)$", head, re.MULTILINE)
    assert author is not None
    assert re.search(rf"Copyright \d{{4}} {author[1]}$", (ROOT / "LICENSE").read_text(), re.MULTILINE)
    assert "# hil-gateway" in body
    assert "docs/bring-up.md" in body
    assert re.findall(r"\]\((?!https?:|#)[^)]*\)", body) == []

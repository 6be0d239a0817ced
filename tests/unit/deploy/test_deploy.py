"""The service files and the install script, as far as they can be judged without a vehicle computer."""

from __future__ import annotations

import configparser
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

DEPLOY = Path(__file__).resolve().parents[3] / "deploy"
UNITS = sorted([*DEPLOY.glob("systemd/*.service"), *DEPLOY.glob("systemd/*.target")])


def install(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([DEPLOY / "install.sh", *arguments], capture_output=True, text=True, check=False)


def files(root: Path) -> set[str]:
    """Installed files outside the program's own folder."""
    return {str(p.relative_to(root)) for p in root.rglob("*") if p.is_file() and "opt/hil-gateway" not in str(p)}


def unit(name: str) -> configparser.ConfigParser:
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read(DEPLOY / "systemd" / name)
    return parser


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd: apt-get install systemd")
def test_systemd_finds_nothing_wrong_with_the_units() -> None:
    path = {"SYSTEMD_UNIT_PATH": f"{DEPLOY / 'systemd'}:"}  # so that the common drop-in is read as well
    command = ["systemd-analyze", "verify", "--man=no", *map(str, UNITS)]
    result = subprocess.run(command, capture_output=True, text=True, env=os.environ | path, check=False)
    assert (result.returncode, result.stderr) == (0, "")
    assert len(UNITS) == 8


@pytest.mark.promise("L5")
def test_a_hanging_gateway_is_killed_within_200_ms_and_started_again() -> None:
    service = unit("hil-gateway.service")["Service"]
    assert (service["Type"], service["WatchdogSec"], service["WatchdogSignal"]) == ("notify", "200ms", "SIGKILL")
    assert (service["CPUSchedulingPolicy"], int(service["CPUSchedulingPriority"])) == ("fifo", 80)
    common = unit("hil-.service.d/common.conf")
    assert (common["Service"]["Restart"], common["Unit"]["StartLimitIntervalSec"]) == ("always", "0")


def test_priorities_fall_along_the_loop() -> None:
    """Gateway before estimator before planner; what only listens has no real-time priority at all."""
    priority = {
        name: int(unit(f"hil-{name}.service")["Service"].get("CPUSchedulingPriority", "0"))
        for name in ("gateway", "estimator", "planner", "recorder", "learner", "dashboard")
    }
    assert priority["gateway"] > priority["estimator"] > priority["planner"] > 0
    assert priority["recorder"] == priority["learner"] == priority["dashboard"] == 0


def test_installing_and_uninstalling_leaves_nothing_behind(tmp_path: Path) -> None:
    assert install("--root", str(tmp_path)).returncode == 0
    installed = files(tmp_path)
    assert {f"etc/systemd/system/{path.name}" for path in UNITS} <= installed
    assert {"etc/hil-gateway/av24.toml", "etc/systemd/network/80-can0.network"} <= installed
    assert (tmp_path / "opt/hil-gateway/hil_gateway/gateway/core.py").is_file()
    assert not any("rules" in name or "listen-only" in name for name in installed)
    assert install("--root", str(tmp_path), "--uninstall").returncode == 0
    assert files(tmp_path) == set()
    assert not (tmp_path / "opt/hil-gateway").exists()


def test_an_edited_configuration_survives_both_installing_again_and_uninstalling(tmp_path: Path) -> None:
    install("--root", str(tmp_path))
    edited = tmp_path / "etc/hil-gateway/av24.toml"
    edited.write_text("# mine\n")
    assert "kept" in install("--root", str(tmp_path)).stderr
    assert "kept" in install("--root", str(tmp_path), "--uninstall").stderr
    assert files(tmp_path) == {"etc/hil-gateway/av24.toml"}
    assert edited.read_text() == "# mine\n"


def test_the_adapter_is_named_by_its_path_and_may_be_made_to_listen_only(tmp_path: Path) -> None:
    install("--root", str(tmp_path), "--can-path", "pci-0000:00:14.0-usb-0:2:1.0", "--listen-only")
    rules = (tmp_path / "etc/udev/rules.d/70-hil-can.rules").read_text()
    assert 'ENV{ID_PATH}=="pci-0000:00:14.0-usb-0:2:1.0", NAME="can0"' in rules
    assert "@ID_PATH@" not in rules
    assert "ListenOnly=yes" in (tmp_path / "etc/systemd/network/80-can0.network.d/listen-only.conf").read_text()


@pytest.mark.parametrize(
    "arguments",
    [
        ["--frobnicate"],
        ["--root"],
        ["--root", "ROOT", "--uninstall"],
        ["--root", "ROOT", "--can-path", "ID_PATH=pci|x"],
    ],
)
def test_wrong_use_of_the_install_script_is_exit_2_and_changes_nothing(tmp_path: Path, arguments: list[str]) -> None:
    result = install(*(str(tmp_path) if word == "ROOT" else word for word in arguments))
    assert result.returncode == 2
    assert result.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_install_script_names_the_step_of_the_guide_that_comes_next(tmp_path: Path) -> None:
    said = re.search(r"next: docs/bring-up.md, step (\d+)", install("--root", str(tmp_path)).stderr)
    assert said is not None
    guide = (DEPLOY.parent / "docs" / "bring-up.md").read_text()
    assert re.search(rf"^### {said[1]}\. Install", guide, re.MULTILINE)


@pytest.mark.parametrize("arguments", [[], ["--help"], ["/proc/nowhere"]])
def test_wrong_use_of_the_certificate_script_is_exit_2(arguments: list[str]) -> None:
    script = DEPLOY / "zenoh" / "make-certificates.sh"
    result = subprocess.run([script, *arguments], capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert result.stderr


@pytest.mark.parametrize(("mark", "folder"), [("mark.vcan", "vcan"), ("mark.quiet", "faults")])
def test_every_test_run_apart_is_where_the_test_script_looks_for_it(mark: str, folder: str) -> None:
    tests = DEPLOY.parent / "tests"
    marked = {path for path in tests.rglob("test_*.py") if mark in path.read_text() and path != Path(__file__)}
    assert marked
    assert all(path.parent == tests / folder for path in marked)


@pytest.mark.slow
@pytest.mark.parametrize(("outcome", "step", "counted"), [
    ("<failure/>", "", "2 passed, 1 failed, 0 skipped"), ("", "vcan-tests\n", "3 passed, 0 failed, 0 skipped"),
])  # fmt: skip
def test_summary_counts_the_tests_run_apart_and_fails_with_a_test_or_a_step(
    tmp_path: Path, outcome: str, step: str, counted: str
) -> None:
    (tmp_path / "steps").write_text("tests ok 1 s\n")
    (tmp_path / "failed").write_text(step)
    for name in ("normal", "vcan"):
        (tmp_path / f"{name}.xml").write_text('<testsuite><testcase classname="a" name="b"/></testsuite>')
    case = f'<testcase classname="a" name="c">{outcome}</testcase>'
    (tmp_path / "quiet.xml").write_text(f"<testsuite>{case}</testsuite>")
    command = [sys.executable, DEPLOY / "summary.py", tmp_path]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 1
    assert counted in result.stdout


@pytest.mark.parametrize(("excused", "code"), [("", 1), ('"a.b" = "ends 3 ms late beside a build"', 0)])
def test_what_passes_only_alone_has_failed_unless_it_is_excused(tmp_path: Path, excused: str, code: int) -> None:
    """With a copy of the script beside a list of its own."""
    script, folder = tmp_path / "deploy" / "summary.py", tmp_path / "results"
    for place in (script.parent, tmp_path / "tests", folder):
        place.mkdir()
    shutil.copy(DEPLOY / "summary.py", script)
    (tmp_path / "tests" / "second_try.toml").write_text(excused)
    case = '<testsuite><testcase classname="a" name="{}">{}</testcase></testsuite>'
    (folder / "normal.xml").write_text(case.format("b", "<failure/>"))
    (folder / "normal-alone.xml").write_text(case.format("b", ""))
    result = subprocess.run([sys.executable, script, folder, "normal"], timeout=60, check=False)
    assert result.returncode == code


def test_every_test_that_is_excused_exists_and_has_its_reason() -> None:
    listed = tomllib.loads((DEPLOY.parent / "tests" / "second_try.toml").read_text())
    for name, reason in listed.items():
        module, _, test = name.rpartition(".")
        assert f"def {test.partition('[')[0]}(" in (DEPLOY.parent / f"{module.replace('.', '/')}.py").read_text()
        assert len(reason) > 20


@pytest.mark.slow
def test_summary_names_the_tests_that_want_vcan_and_why_they_did_not_run(tmp_path: Path) -> None:
    (tmp_path / "steps").write_text("tests ok 1 s\n")
    (tmp_path / "vcan.log").write_text("with-vcan: no vcan0: no room\n")
    (tmp_path / "normal.xml").write_text('<testsuite><testcase classname="a" name="b"/></testsuite>')
    command = [sys.executable, DEPLOY / "summary.py", tmp_path]
    result = subprocess.run(command, capture_output=True, text=True, cwd=DEPLOY.parent, timeout=120, check=False)
    assert result.returncode == 0
    named = re.findall(r"^not run: (tests/vcan/\S+::test_\w+)", result.stdout, re.MULTILINE)
    assert f"{len(named)} tests not run, they need vcan: with-vcan: no vcan0: no room" in result.stdout
    assert len(named) > 10
    assert f"1 passed, 0 failed, {len(named)} skipped" in result.stdout

"""Every script of docs/examples runs and prints what it says.

`my_planner` drives in `test_other_cars.py`, `my_ros_planner` in `test_ros_planner.py`, `read_session` reads in
`test_replay_and_table.py`, `diagnose_my_log` prints in `test_diagnose.py`.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from support.drives.drive_simulator import TYRE, simulate, to_csv
from support.examples import EXAMPLES, run_example

RUN = {"my_car", "read_session", "identify_my_log", "diagnose_my_log", "my_planner", "my_ros_planner"}


def test_every_example_is_run_by_a_test() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == RUN


def test_a_car_of_my_own_is_checked_and_drives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HIL_PLATFORM", "av24")  # what the example sets is put back after the test
    run_example("my_car", [str(tmp_path / "mine"), "4"], monkeypatch)
    said = capsys.readouterr().out
    assert "640 kg, 2 inertial sensors" in said
    assert "off the road 0 times\nno stop" in said


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "drive.csv"
    path.write_text(to_csv(simulate([TYRE], 25.0, seed=31)[0].columns))
    return path


def test_my_log_is_identified(log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    run_example("identify_my_log", [str(log)], monkeypatch)
    assert "ay: error on held-out data" in capsys.readouterr().out

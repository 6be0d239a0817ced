"""The folder of a demo: nothing is lost, nothing foreign is touched, one demo at a time, no work without space."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hil_gateway.config import load_config
from hil_gateway.demo.folder import MARKER, check_drive_folder, claim
from hil_gateway.demo.options import DemoOptions, prepare
from hil_gateway.process.errors import InputError

LEFT = ("session.mcap", "session_001.mcap", "config.toml", "logs/planner.log", "diagnosis/model.json")


def leave_a_drive(folder: Path, content: str) -> None:
    """What a demo leaves, without the drive."""
    with claim(folder):
        for name in LEFT:
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(content)


def everything(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_a_drive_into_the_same_folder_keeps_every_earlier_drive_whole(tmp_path: Path) -> None:
    (tmp_path / "session_recovered.mcap").write_text("mine")
    for drive in ("first", "second", "third"):
        leave_a_drive(tmp_path, drive)
    found = everything(tmp_path)
    for place, drive in (("earlier-1/", "first"), ("earlier-2/", "second"), ("", "third")):
        assert {found[place + name] for name in LEFT} == {drive.encode()}
    assert found["session_recovered.mcap"] == b"mine"


@pytest.mark.parametrize("name", ["session.mcap", "session_007.mcap", "config.toml", "logs/planner.log"])
def test_what_no_demo_made_is_neither_moved_nor_written_over(tmp_path: Path, name: str) -> None:
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("of somebody else")
    before = everything(tmp_path)
    with pytest.raises(InputError, match="not made by a demo here, left as it is; choose another --out"):
        prepare(DemoOptions(out=tmp_path))
    assert everything(tmp_path) == before


def test_files_that_are_not_in_the_way_do_not_matter(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("")  # as `hil demo --out DIR --json > DIR/summary.json` makes it
    prepare(DemoOptions(out=tmp_path)).lock.release()
    assert (tmp_path / "summary.json").read_text() == ""


def test_the_configuration_that_was_given_is_never_written_over(tmp_path: Path) -> None:
    given = tmp_path / "config.toml"
    given.write_text("[plant]\nseed = 5\n")
    with pytest.raises(InputError, match=r"config\.toml: was given to the demo"):
        prepare(DemoOptions(out=tmp_path, config_file=given))
    assert given.read_text() == "[plant]\nseed = 5\n"


def test_a_model_of_the_folder_is_not_moved_away_from_under_the_demo(tmp_path: Path) -> None:
    leave_a_drive(tmp_path, "first")
    with pytest.raises(InputError, match="diagnosis: was given to the demo"):
        check_drive_folder(tmp_path, [tmp_path / "diagnosis" / "model.json"], 0)


def test_two_demos_never_write_into_one_folder(tmp_path: Path) -> None:
    """The other one is a process of its own, so that the lock is the kernel's."""
    code = f"from pathlib import Path; from hil_gateway.demo.folder import claim\nlock = claim(Path({str(tmp_path)!r}))"
    code += "\nprint('locked', flush=True); input()"
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "locked\n"
        with pytest.raises(InputError, match=rf"a demo is writing there now \(process {other.pid} since"):
            check_drive_folder(tmp_path, (), 0)
        other.kill()
        other.wait()
    check_drive_folder(tmp_path, (), 0)
    claim(tmp_path).release()


def test_too_little_disk_is_said_before_anything_starts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HIL_RECORDER__MIN_FREE_BYTES", str(10**18))
    with pytest.raises(InputError, match=r"no drive would be recorded: \d+ MB free on this disk.*min_free_bytes"):
        prepare(DemoOptions(out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["🏎 lap", "Über \\ \"quoted\" 'x'", "ends.with.dots..", "日本"])
def test_any_readable_name_is_a_folder_the_processes_find(tmp_path: Path, name: str) -> None:
    setup = prepare(DemoOptions(out=tmp_path / name))
    setup.lock.release()
    assert load_config(setup.config_file) == setup.config
    assert setup.config.recorder.folder == str(tmp_path / name)


@pytest.mark.parametrize("name", [b"\xff\xfe", b"two\nlines", b"bell\x07", b"x" * 300, b"new/" + b"x" * 300])
def test_other_names_are_refused_and_nothing_is_made(tmp_path: Path, name: bytes) -> None:
    with pytest.raises(InputError) as raised:
        prepare(DemoOptions(out=tmp_path / os.fsdecode(name)))
    assert "\n" not in str(raised.value)
    assert "--out" in str(raised.value)
    assert list(tmp_path.iterdir()) == []


def test_the_marker_stays_so_that_the_next_demo_knows_its_own(tmp_path: Path) -> None:
    for _ in range(2):
        prepare(DemoOptions(out=tmp_path)).lock.release()
        assert (tmp_path / MARKER).is_file()

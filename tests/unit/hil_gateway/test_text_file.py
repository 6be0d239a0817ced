"""Files that users give end in what they hold or in one line, never in a wait, a traceback or a full memory."""

from __future__ import annotations

import os
import resource
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from hil_gateway.process.errors import InputError
from hil_gateway.text_file import read_json, read_text, read_toml


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))


NO_FILES: dict[str, tuple[Callable[[Path], object], str]] = {
    "absent": (lambda path: None, "No such file"),
    "folder": (lambda path: path.mkdir(), "directory"),
    "pipe": (os.mkfifo, "a pipe, socket or device; write it to a file first"),
    "socket": (_socket, "a pipe, socket or device"),
    "circle": (lambda path: path.symlink_to(path), "symbolic links"),
    "too much": (lambda path: path.write_bytes(b"a" * 1001), "a track has at most 1000 bytes"),
    "zeros": (lambda path: path.symlink_to("/dev/zero"), "a pipe, socket or device"),
    "nothing": (lambda path: path.symlink_to(os.devnull), "a pipe, socket or device"),
    "noise": (lambda path: path.symlink_to("/dev/urandom"), "a pipe, socket or device"),
}


@pytest.mark.promise("D4")
@pytest.mark.parametrize("kind", NO_FILES)
def test_what_is_no_file_is_named_and_not_waited_for(tmp_path: Path, kind: str) -> None:
    make, said = NO_FILES[kind]
    make(tmp_path / "in")
    with pytest.raises(InputError, match=said):
        read_text(tmp_path / "in", "track", 1000)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b'{"mass": 1, "mass": 2}', "key 'mass' is there twice"),
        (b"[" * 200_000, "nested too deeply"),
        (b"1" + b"0" * 5000, "not valid JSON: Exceeds the limit"),
        (b"\xff\xfe{", "byte 0 is not UTF-8"),
        (b"", "not valid JSON"),
    ],
)
def test_a_json_file_that_cannot_be_meant_is_one_line(tmp_path: Path, text: bytes, said: str) -> None:
    (tmp_path / "car.json").write_bytes(text)
    with pytest.raises(InputError, match=said):
        read_json(tmp_path / "car.json")


@pytest.mark.promise("D4")
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = " + "[" * 100_000, "nested too deeply"),
        ("x = 1\n" + ".".join(["a"] * 20_000) + " = 1", ":2: nested too deeply: a key has at most 20 parts"),
        ("x = {" + " . ".join(["a"] * 20_000) + " = 1}", ":1: nested too deeply"),
        ("a = 1" + "0" * 10_000, "not valid TOML: Exceeds the limit"),
        ("a = 1\na = 2", "not valid TOML"),
    ],
)
def test_a_toml_file_that_cannot_be_meant_is_one_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "car.toml").write_text(text)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=said):
        read_toml(tmp_path / "car.toml")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # KiB


def test_a_table_of_numbers_is_no_long_key(tmp_path: Path) -> None:
    rows = ",\n".join("[" + ", ".join(["1.5"] * 50) + "]" for _ in range(3))
    (tmp_path / "car.toml").write_text(f"a = [\n{rows}]")
    assert len(read_toml(tmp_path / "car.toml")["a"]) == 3


def test_a_mark_of_byte_order_and_line_ends_of_windows_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_bytes(b"\xef\xbb\xbfa = 1\r\n")
    (tmp_path / "a.json").write_bytes(b'\xef\xbb\xbf{"a": 1}\r\n')
    assert read_toml(tmp_path / "a.toml") == read_json(tmp_path / "a.json") == {"a": 1}

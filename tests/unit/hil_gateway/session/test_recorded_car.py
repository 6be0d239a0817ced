"""A recording is read with the car it was recorded with, or refused with the remedy."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hil_gateway.can_link import Frame
from hil_gateway.can_link.cdr import pack_frame
from hil_gateway.car.car import load_car
from hil_gateway.config import Config
from hil_gateway.process.errors import InputError
from hil_gateway.session.exchange.signals import export_signals
from hil_gateway.session.files.configuration import recorded_car, recorded_config
from hil_gateway.session.files.format import CAN_TOPIC, session_metadata
from hil_gateway.session.files.writer import SessionFile

S = 1_000_000_000


def recording(path: Path, config: Config) -> Path:
    message = next(m for m in config.car.codec.messages.values() if m.direction == "car")
    metadata = {"session": session_metadata(config, path.stem, "wire", "now")}
    with SessionFile(path, metadata, attached=config.car.files()) as file:
        for second in (1, 2):
            frame = Frame(message.id, bytes(message.dlc), second * S, False)
            file.add(CAN_TOPIC, pack_frame(frame, second * S), second * S, second * S, second)
    return path


@pytest.fixture
def kestrel(tmp_path: Path) -> Path:
    return recording(tmp_path / "kestrel.mcap", Config(platform="kestrel"))


def test_frames_are_decoded_and_numbers_taken_by_the_recorded_car(kestrel: Path, tmp_path: Path) -> None:
    assert recorded_config(kestrel).vehicle == load_car("kestrel").vehicle
    assert recorded_car([kestrel]) == load_car("kestrel")
    export_signals(kestrel, tmp_path / "s.csv")
    first = next(m for m in load_car("kestrel").codec.messages.values() if m.direction == "car")
    assert f"{first.name}." in (tmp_path / "s.csv").read_text()


def test_the_named_car_comes_before_the_recorded_one(kestrel: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HIL_PLATFORM", "av21")
    assert recorded_car([kestrel]).platform == "av21"


def test_recordings_of_two_cars_are_no_data_set(kestrel: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is of the car kestrel.*of av24.*those of one car"):
        recorded_car([kestrel, recording(tmp_path / "av24.mcap", Config(platform="av24"))])


def test_a_recording_whose_car_is_gone_is_refused_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, gone = tmp_path / "s.mcap", tmp_path / "my_car"
    with SessionFile(path, {"session": {"config": json.dumps({"platform": str(gone)})}}) as file:
        file.add(CAN_TOPIC, pack_frame(Frame(0x514, bytes(8), S, False), S), S, S, 0)
    with pytest.raises(InputError, match=r"recorded with the car .*my_car.*--platform"):
        recorded_car([path])
    monkeypatch.setenv("HIL_PLATFORM", "kestrel")
    assert recorded_car([path]) == load_car("kestrel")

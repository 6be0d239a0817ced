"""Configuration: every mistake is one line that names where, what and what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil_gateway.config import Config, load_config
from hil_gateway.errors import InputError


def _write(folder: Path, text: str) -> Path:
    path = folder / "car.toml"
    path.write_text(text)
    return path


def test_flags_override_environment_overrides_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = _write(tmp_path, '[can]\nchannel = "file"\nbitrate = 500000\n')
    assert load_config(path).can.channel == "file"
    monkeypatch.setenv("HIL_CAN__CHANNEL", "environment")
    assert load_config(path).can.channel == "environment"
    config = load_config(path, {"can.channel": "flag"})
    assert (config.can.channel, config.can.bitrate) == ("flag", 500000)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[can]\nchanel = 'can0'\n", "unknown key can.chanel"),
        ("[planner]\ndt = -1\n", "planner.dt = -1"),
        ("[vehicle]\nmass = nan\n", "vehicle.mass"),
        ("[can\n", "not valid TOML"),
    ],
)
def test_bad_file_names_file_key_and_value(tmp_path: Path, text: str, expected: str) -> None:
    path = _write(tmp_path, text)
    with pytest.raises(InputError) as error:
        load_config(path)
    assert expected in str(error.value)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_missing_file_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read"):
        load_config(tmp_path / "absent.toml")


def test_no_file_gives_the_defaults() -> None:
    assert load_config() == Config()


def test_lists_and_tables_in_the_environment_are_written_as_in_toml(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HIL_ZENOH__CONNECT", '["tcp/127.0.0.1:7001", "tcp/127.0.0.1:7002"]')
    monkeypatch.setenv("HIL_PLANT__EFFECTS", "{aero_drag = 1.2}")
    config = load_config()
    assert config.zenoh.connect == ("tcp/127.0.0.1:7001", "tcp/127.0.0.1:7002")
    assert config.plant.effects == {"aero_drag": 1.2}
    monkeypatch.setenv("HIL_ZENOH__CONNECT", "[tcp/127.0.0.1:7001")
    with pytest.raises(InputError, match=r"HIL_ZENOH__CONNECT=.*not a TOML list"):
        load_config()

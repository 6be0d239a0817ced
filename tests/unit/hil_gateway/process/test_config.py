"""Configuration: every mistake is one line that names where, what and what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil_gateway.config import Config, load_config
from hil_gateway.process.errors import InputError


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


def test_a_car_that_a_file_names_is_the_same_as_one_that_the_command_line_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    named = load_config(_write(tmp_path, 'platform = "kestrel"\n'))
    assert named.vehicle != Config().vehicle
    monkeypatch.setenv("HIL_PLATFORM", "kestrel")
    assert named == load_config()
    assert load_config(_write(tmp_path, "[vehicle]\nmass = 700.0\n")).declared_car.vehicle.mass == 700.0


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[can]\nchanel = 'can0'\n", "unknown key can.chanel"),
        ("[planner]\ndt = -1\n", "planner.dt = -1"),
        ("[vehicle]\nmass = nan\n", "vehicle.mass"),
        ("[can\n", "not valid TOML"),
        ("[gateway.limits]\nsteering_rate = 49\n", "gateway.limits.steering_rate = 49: between 171.887 and 500"),
        ("[gateway.limits]\nbrake_rise = 99\n", "gateway.limits.brake_rise = 99: between 12000 and 180000"),
        ("[powertrain]\nengine_torque = [300, 430, 520, 560, 566, 551]\n", "engine_torque has 6 values for 8"),
        ("[powertrain]\ndownshift_rpm = 6600\n", "clutch_rpm < downshift_rpm < upshift_rpm"),
        ("[powertrain]\nbrake_force_per_pa = 1e-4\n", "emergency_deceleration asks for 12"),
        ("a = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
        ("#" * 20_000_001, "a configuration has at most 20000000"),
    ],
)
def test_bad_file_names_file_key_and_value(tmp_path: Path, text: str, expected: str) -> None:
    path = _write(tmp_path, text)
    with pytest.raises(InputError) as error:
        load_config(path)
    assert expected in str(error.value)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_mistake_in_the_environment_or_a_flag_is_said_to_be_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = _write(tmp_path, '[can]\nchannel = "file"\n')
    with pytest.raises(InputError, match=r"^command line: dashboard\.port = 99999: "):
        load_config(path, {"dashboard.port": 99999})
    for name, words in (
        ("HIL_CAN__CHANEL", "unknown key can.chanel"),
        ("HIL_CAN__BITRATE", "can.bitrate = 'abc'"),
        ("HIL_ZENOH__CONNECT", "zenoh.connect = 'abc': should be a list"),
        ("HIL_GATEWAY", "gateway = 'abc': should be a table"),
        ("HIL_GATEWEY__MODE", "unknown key gatewey"),
        ("HIL_MODE", "no setting; meant is HIL_ZENOH__MODE or HIL_GATEWAY__MODE"),
    ):
        monkeypatch.setenv(name, "abc")
        with pytest.raises(InputError, match=f"^{name}: {words}"):
            load_config(path)
        monkeypatch.delenv(name)


def test_one_underscore_too_few_is_an_error_and_not_the_default(monkeypatch: pytest.MonkeyPatch) -> None:
    """HIL_GATEWAY_MODE=listen would else run a gateway that can be armed."""
    monkeypatch.setenv("HIL_GATEWAY_MODE", "listen")
    with pytest.raises(InputError, match=r"HIL_GATEWAY_MODE: no setting; HIL_GATEWAY__MODE sets gateway\.mode"):
        load_config()


def test_a_value_where_a_table_should_be_is_said_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HIL_GATEWAY__MODE", "listen")
    with pytest.raises(InputError, match="gateway = 3: should be a table"):
        load_config(_write(tmp_path, "gateway = 3\n"))


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
    with pytest.raises(InputError, match=r"^HIL_ZENOH__CONNECT=[^ ]*: not valid TOML: .* written as in TOML$"):
        load_config()


def test_config_diff_names_what_was_changed_where_and_config_show_its_range(tmp_path: Path, monkeypatch) -> None:
    import json

    from typer.testing import CliRunner

    from hil_gateway.cli.main import app

    file = tmp_path / "car.toml"
    file.write_text("[vehicle]\nmass = 810.0\n")
    monkeypatch.setenv("HIL_DASHBOARD__PORT", "9000")
    run = CliRunner()
    rows = json.loads(run.invoke(app, ["config", "diff", "--config", str(file), "--json"]).stdout)["settings"]
    assert {row["key"]: (row["value"], row["default"], row["origin"]) for row in rows} == {
        "vehicle.mass": (810.0, 787.3, str(file)),
        "dashboard.port": (9000, 8024, "HIL_DASHBOARD__PORT"),
    }
    monkeypatch.setenv("HIL_PLATFORM", "kestrel")  # as --platform does: a car has its own defaults
    assert "platform = kestrel (HIL_PLATFORM)" in run.invoke(app, ["config", "show"]).output
    monkeypatch.delenv("HIL_PLATFORM")
    shown = run.invoke(app, ["config", "show"]).output
    assert "planner.backend = auto   # auto | fixed | hpipm | piqp" in shown
    assert "dashboard.rate_hz = 10.0   # > 0, <= 50; updates a second sent to each page" in shown

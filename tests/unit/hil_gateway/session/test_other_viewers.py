"""Foxglove, PlotJuggler and readers of ROS 2 bags find what they look for."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from support.cars.session_rig import UNIX_NS, recorded

from hil_gateway.bus import messages as m
from hil_gateway.bus.event import Event, EventKind, Severity
from hil_gateway.bus.race_line import RaceLine
from hil_gateway.bus.topics import ESTIMATE, EVENT, RACE_LINE, TOPICS
from hil_gateway.config import Config
from hil_gateway.process.errors import InputError
from hil_gateway.process.shipped import template
from hil_gateway.session.exchange.foxglove import CHANNELS, LOCATION, LOG, SCENE, TRANSFORM, export_foxglove
from hil_gateway.session.exchange.foxglove_schemas import SCHEMAS
from hil_gateway.session.exchange.ros2 import export_ros2
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.files.writer import SessionFile
from hil_gateway.track.geodesy import LocalMap

PLACE = (120.0, -80.0, 0.5)
STOP = Event(
    stamp_ns=5, seq=0, kind=EventKind.FAILSAFE, severity=Severity.STOP, before="drive", after="controlled_stop",
    cause="command_stale", text="no fresh planner command",
)  # fmt: skip


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """An estimate, a race line and a stop."""
    x, y, yaw = PLACE
    estimate = m.Estimate(
        stamp_ns=1, seq=1, state_stamp_ns=1, valid=True, x=x, y=y, yaw=yaw, vx=50, vy=0, yaw_rate=0, bias_ax=0,
        bias_ay=0, bias_yaw_rate=0, std=(0.1, 0.2, *(0.1,) * 7), steer=0, drive=0, innovations_rejected=0,
    )  # fmt: skip
    three = (0.0, 1.0, 2.0)
    line = RaceLine(stamp_ns=2, seq=0, x=three, y=three, vx=three, track_s=three, clearance_m=1.4, lap_time_s=80)
    metadata = {"session": {"config": Config().model_dump_json()}}
    with SessionFile(tmp_path / "drive.mcap", metadata) as file:
        for topic, message in ((ESTIMATE, estimate), (RACE_LINE, line), (EVENT, STOP)):
            file.add(topic.key, message.model_dump_json().encode(), UNIX_NS, UNIX_NS + message.stamp_ns, 0)
    return tmp_path / "drive.mcap"


def read(path: Path) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """(topic, schema, content) as the MCAP library reads it, checksums and all."""
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            yield channel.topic, schema.name if schema else "", json.loads(message.data)


def matches(value: Any, schema: Any) -> bool:
    """Whether `value` holds what `schema` says, no less and no more."""
    if schema["type"] == "object":
        names = schema["properties"]
        return value.keys() == names.keys() and all(matches(value[name], names[name]) for name in names)
    if schema["type"] == "array":
        return all(matches(entry, schema["items"]) for entry in value)
    kinds = {"number": (int, float), "integer": int, "string": str, "boolean": bool}
    return isinstance(value, kinds[schema["type"]])


def test_foxglove_topics_stand_beside_ours_and_hold_what_their_schemas_say(drive: Path, tmp_path: Path) -> None:
    done = export_foxglove(drive, tmp_path / "out.mcap")
    content = list(read(tmp_path / "out.mcap"))
    assert {topic for topic, _, _ in content} == {ESTIMATE.key, RACE_LINE.key, EVENT.key, *CHANNELS}
    made = [(name, tree) for topic, name, tree in content if topic in CHANNELS]
    assert len(made) == done.rows
    entities = SCHEMAS["foxglove.SceneUpdate"]["properties"]["entities"]["items"]["properties"]
    assert entities.keys() >= {"frame_id", "lifetime", "lines", "cubes"}
    assert all(matches(tree, SCHEMAS[name]) for name, tree in made)


def test_place_heading_and_stop_are_the_recorded_ones(drive: Path, tmp_path: Path) -> None:
    export_foxglove(drive, tmp_path / "out.mcap")
    found = {topic: tree for topic, _, tree in read(tmp_path / "out.mcap")}
    fix, turn = found[LOCATION], found[TRANSFORM]["rotation"]
    back = LocalMap(Config().origin).to_map(fix["latitude"], fix["longitude"])
    assert back == pytest.approx(PLACE[:2], abs=1e-3)
    assert 2 * math.atan2(turn["z"], turn["w"]) == pytest.approx(PLACE[2])
    assert "command_stale" in found[LOG]["message"] and found[LOG]["level"] == 4
    assert found[SCENE]["entities"][0]["id"] == "race line"
    assert found[LOG]["timestamp"] == {"sec": UNIX_NS // 10**9, "nsec": 5}


def test_a_ros_2_file_has_the_profile_and_nothing_but_the_frames(tmp_path: Path) -> None:
    recorded(tmp_path / "s.mcap")
    done = export_ros2(tmp_path / "s.mcap", tmp_path / "ros.mcap")
    frames = [item.data for item in SessionReader(tmp_path / "s.mcap").items() if item.topic == "av24/can"]
    with (tmp_path / "ros.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        content = [(s.name if s else "", c.message_encoding, msg.data) for s, c, msg in reader.iter_messages()]
    assert content == [("can_msgs/msg/Frame", "cdr", data) for data in frames]
    assert done.rows == len(frames) > 100


def test_a_session_without_frames_makes_no_ros_2_file(drive: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no raw frame"):
        export_ros2(drive, tmp_path / "ros.mcap")
    assert not (tmp_path / "ros.mcap").exists()


FIELDS = {topic.key: set(topic.message.model_fields) for topic in TOPICS}


def test_every_field_the_foxglove_layout_names_is_recorded() -> None:
    layout = json.loads(template("foxglove-layout.json"))
    paths = re.findall(r'"value": "([^"]+)"', json.dumps(layout))
    assert len(paths) > 10
    for topic, _, field in (path.partition(".") for path in paths):
        assert field in FIELDS[topic], f"{topic}.{field}"
    text = json.dumps(layout["configById"])
    assert set(re.findall(r"foxglove/\w+", text)) <= set(CHANNELS)
    placed = set(re.findall(r'"((?:first|second))": "([^"]+)"', json.dumps(layout["layout"])))
    assert {panel for _, panel in placed} == set(layout["configById"])


def test_every_curve_of_the_plotjuggler_layout_is_recorded() -> None:
    curves = re.findall(r'<curve name="([^"]+)"', template("plotjuggler-layout.xml"))
    assert len(curves) > 8
    for topic, _, field in (curve.rpartition("/") for curve in curves):
        assert field in FIELDS[topic], f"{topic}/{field}"

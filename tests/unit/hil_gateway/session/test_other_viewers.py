"""PlotJuggler and readers of ROS 2 bags find what they look for."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from mcap.reader import make_reader
from support.cars.session_rig import UNIX_NS, recorded

from hil_gateway.bus import messages as m
from hil_gateway.bus.topics import ESTIMATE, TOPICS
from hil_gateway.config import Config
from hil_gateway.process.errors import InputError
from hil_gateway.process.shipped import template
from hil_gateway.session.exchange.ros2 import export_ros2
from hil_gateway.session.files.reader import SessionReader
from hil_gateway.session.files.writer import SessionFile


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A session of one estimate, without a frame."""
    estimate = m.Estimate(
        stamp_ns=1, seq=1, state_stamp_ns=1, valid=True, x=0, y=0, yaw=0, vx=50, vy=0, yaw_rate=0, bias_ax=0,
        bias_ay=0, bias_yaw_rate=0, std=(0.1, 0.2, *(0.1,) * 7), steer=0, drive=0, innovations_rejected=0,
    )  # fmt: skip
    metadata = {"session": {"config": Config().model_dump_json()}}
    with SessionFile(tmp_path / "drive.mcap", metadata) as file:
        file.add(ESTIMATE.key, estimate.model_dump_json().encode(), UNIX_NS, UNIX_NS + 1, 0)
    return tmp_path / "drive.mcap"


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


def test_every_curve_of_the_plotjuggler_layout_is_recorded() -> None:
    curves = re.findall(r'<curve name="([^"]+)"', template("plotjuggler-layout.xml"))
    assert len(curves) > 8
    for topic, _, field in (curve.rpartition("/") for curve in curves):
        assert field in FIELDS[topic], f"{topic}/{field}"

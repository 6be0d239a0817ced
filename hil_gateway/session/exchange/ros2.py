"""Session -> MCAP file of profile ros2, which readers of ROS 2 bags take (rosbags, `ros2 bag`).

It holds the raw frames, and what was driven as drivers and estimators of ROS cars publish it. Readers refuse a file
with anything but ROS messages, so the JSON topics stay behind.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.writer import Writer

from hil_gateway.bus.messages import Estimate, VehicleState
from hil_gateway.bus.topics import ESTIMATE, VEHICLE_STATE
from hil_gateway.can_link.cdr import CAN_SCHEMA, CAN_SCHEMA_NAME
from hil_gateway.process.errors import InputError
from hil_gateway.ros2 import topics as ros
from hil_gateway.ros2.outgoing import Outgoing
from hil_gateway.ros2.topics import RosTopic
from hil_gateway.ros2.types import Types
from hil_gateway.session.exchange.export import Exported
from hil_gateway.session.files.configuration import recorded_config
from hil_gateway.session.files.format import CAN_TOPIC, METADATA_SESSION, unpack_message
from hil_gateway.session.files.output import output_file
from hil_gateway.session.files.reader import Item, SessionReader

FRAMES = "/can"
"""ROS names begin with a slash"""
GENERATION = "av24"
NEEDS_TYPES = "state or estimate, for which hil-gateway[ros2] is not installed"
Stamped = tuple[RosTopic, int, Any]
"""topic, Unix ns, message"""


def export_ros2(source: Path, target: Path) -> Exported:
    """Every raw frame as `can_msgs/msg/Frame`, stamps as recorded, and what was driven; rows are frames.

    Raises:
        InputError: no readable recording, or none with raw frames; `target` cannot be written.
    """
    count, reader = 0, SessionReader(source, frozenset({CAN_TOPIC, VEHICLE_STATE.key, ESTIMATE.key}))
    with output_file(target, source) as path, path.open("wb") as file:
        writer = Writer(file, enable_data_crcs=True)
        writer.start(profile="ros2", library="hil-gateway")
        schema = writer.register_schema(CAN_SCHEMA_NAME, "ros2msg", CAN_SCHEMA.encode())
        channel = writer.register_channel(FRAMES, "cdr", schema, {"offered_qos_profiles": ""})
        driven, left_out = _driven(writer, recorded_config(source).vehicle.steering_ratio), 0
        for item in reader.items():
            if item.topic == CAN_TOPIC:
                writer.add_message(channel, item.log_ns, item.data, item.publish_ns, item.sequence)
                count += 1
                continue
            if driven is None:
                left_out += 1
            else:
                driven.add(item)
        if not count:
            raise InputError(f"{source}: holds no raw frame; record with the gateway running, or import a log")
        writer.add_metadata(METADATA_SESSION, reader.metadata.get(METADATA_SESSION, {}))
        writer.finish()
    return Exported(count, {NEEDS_TYPES: left_out} if left_out else {}, tuple(map(str, reader.damage)))


def _driven(writer: Writer, steering_ratio: float) -> _Driven | None:
    """None where the types of ROS are not installed."""
    try:
        return _Driven(writer, steering_ratio)
    except InputError:
        return None


@dataclass
class _Driven:
    """Writes states and valid estimates as typed messages."""

    writer: Writer
    steering_ratio: float
    types: Types = field(default_factory=lambda: Types(GENERATION))
    _channels: dict[RosTopic, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._make = Outgoing(self.types)

    def add(self, item: Item) -> None:
        """One message of the bus."""
        for topic, unix_ns, message in self._messages(item):
            data = self.types.to_bytes(topic.type, message)
            self.writer.add_message(self._channel(topic), item.log_ns, data, unix_ns, item.sequence)

    def _messages(self, item: Item) -> Iterator[Stamped]:
        if item.topic == VEHICLE_STATE.key:
            yield from self._of_state(unpack_message(VEHICLE_STATE, item.data), item.publish_ns)
        else:
            estimate: Estimate = unpack_message(ESTIMATE, item.data)
            unix_ns = item.publish_ns - (estimate.stamp_ns - estimate.state_stamp_ns)
            if estimate.valid:
                yield ros.ODOMETRY, unix_ns, self._make.odometry(estimate, unix_ns)

    def _of_state(self, state: VehicleState, unix_ns: int) -> Iterator[Stamped]:
        yield ros.IMU, unix_ns, self._make.imu(state, unix_ns)
        for topic in ros.REPORTS:
            yield topic, unix_ns, self._make.report(topic, state, self.steering_ratio, unix_ns)

    def _channel(self, topic: RosTopic) -> int:
        if topic not in self._channels:
            schema = self.writer.register_schema(topic.type, "ros2msg", self.types.definition(topic.type).encode())
            number = self.writer.register_channel(topic.name, "cdr", schema, {"offered_qos_profiles": ""})
            self._channels[topic] = int(number)
        return self._channels[topic]

"""Session -> its raw frames as an MCAP file of profile ros2, which readers of ROS 2 bags take (rosbags, `ros2 bag`).

They refuse a file that holds anything but ROS messages, so the JSON topics stay behind.
"""

from __future__ import annotations

from pathlib import Path

from mcap.writer import Writer

from hil_gateway.process.errors import InputError
from hil_gateway.session.exchange.export import Exported
from hil_gateway.session.files.format import CAN_SCHEMA, CAN_SCHEMA_NAME, CAN_TOPIC, METADATA_SESSION
from hil_gateway.session.files.output import output_file
from hil_gateway.session.files.reader import SessionReader

TOPIC = "/can"
"""ROS names begin with a slash"""


def export_ros2(source: Path, target: Path) -> Exported:
    """Every raw frame as `can_msgs/msg/Frame`, stamps as recorded.

    Raises:
        InputError: no readable recording, or none with raw frames; `target` cannot be written.
    """
    count, reader = 0, SessionReader(source, frozenset({CAN_TOPIC}))
    with output_file(target, source) as path, path.open("wb") as file:
        writer = Writer(file, enable_data_crcs=True)
        writer.start(profile="ros2", library="hil-gateway")
        schema = writer.register_schema(CAN_SCHEMA_NAME, "ros2msg", CAN_SCHEMA.encode())
        channel = writer.register_channel(TOPIC, "cdr", schema, {"offered_qos_profiles": ""})
        for item in reader.items():
            writer.add_message(channel, item.log_ns, item.data, item.publish_ns, item.sequence)
            count += 1
        if not count:
            raise InputError(f"{source}: holds no raw frame; record with the gateway running, or import a log")
        writer.add_metadata(METADATA_SESSION, reader.metadata.get(METADATA_SESSION, {}))
        writer.finish()
    return Exported(count, {}, tuple(map(str, reader.damage)))

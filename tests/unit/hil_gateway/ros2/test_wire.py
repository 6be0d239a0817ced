"""Names and bytes of rmw_zenoh, against the literal examples of its design document and an independent packer."""

from __future__ import annotations

import struct
from types import SimpleNamespace

import pytest
from zenoh import ext
from zenoh_ros2_sdk.attachment import Attachment as SdkAttachment
from zenoh_ros2_sdk.qos import DEFAULT_QOS_PROFILE, QosDurability, QosProfile, QosReliability

from hil_gateway.ros2 import topics as ros
from hil_gateway.ros2.session import _declare_publisher
from hil_gateway.ros2.wire import (
    Attachment,
    Kind,
    Node,
    Qos,
    RosType,
    Token,
    data_key,
    gid,
    parse_token,
    unpack_attachment,
)

STRING = RosType("std_msgs/msg/String", "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18")
TALKER = (
    "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/"
    f"{STRING.hash}/::,7:,:,:,,"
)
"""from the design document, as the node's own"""


def test_tokens_and_key_are_those_of_the_design_document():
    node = Node(2, "8b20917502ee955ac4476e0266340d5c", "talker")
    assert node.endpoint_token(10, Kind.PUBLISHER, "/chatter", STRING, Qos(depth=7)) == TALKER
    assert Node(2, "aac3178e146ba6f1fc6e6a4085e77f21", "listener").token == (
        "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener"
    )
    assert data_key(0, "/chatter", STRING) == f"0/chatter/std_msgs::msg::dds_::String_/{STRING.hash}"
    assert data_key(3, "/vehicle/odometry", STRING).startswith("3/vehicle/odometry/std_msgs")


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (Qos(depth=42), DEFAULT_QOS_PROFILE),
        (Qos(depth=10), QosProfile(history_depth=10)),
        (Qos(depth=5, best_effort=True), QosProfile(reliability=QosReliability.BEST_EFFORT, history_depth=5)),
        (Qos(depth=1, transient_local=True), QosProfile(durability=QosDurability.TRANSIENT_LOCAL, history_depth=1)),
    ],
)
def test_qos_is_read_by_another_implementation_as_it_is_meant(ours, theirs):
    assert QosProfile.decode(ours.encoded()) == theirs


def test_qos_is_spelt_as_by_rmw_zenoh():
    assert Qos(depth=10).encoded() == "::,10:,:,:,,"
    assert Qos(depth=5, best_effort=True).encoded() == "2::,5:,:,:,,"
    assert Qos(depth=1, transient_local=True).encoded() == ":1:,1:,:,:,,"


def test_token_of_another_node_is_read_with_its_namespace_and_with_chunks_that_are_yet_to_come():
    assert parse_token(TALKER) == Token(
        "8b20917502ee955ac4476e0266340d5c", "MP", "/talker", "/chatter", "std_msgs::msg::dds_::String_", STRING.hash
    )
    nested = TALKER.replace("/%/%/talker", "/%/%ns%a/talker") + "/backends:a,b"
    token = parse_token(nested)
    assert token is not None
    assert (token.node, token.topic) == ("/ns/a/talker", "/chatter")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "@ros2_lv",
        "@ros2_lv/0/z/0/1/MP/%/%/n",
        "a/b/c/d/e/f/g/h/i",
        TALKER.replace("MP", "SS"),
        "@ros2_lv" + 5000 * "/a",
    ],
)
def test_what_is_no_token_of_a_topic_is_none(text):
    assert parse_token(text) is None


def test_attachment_is_the_33_bytes_that_zenoh_itself_and_the_other_implementation_write():
    packed = Attachment(7, 1_700_000_000_123_456_789, b"0123456789abcdef").packed()
    assert len(packed) == 33
    assert SdkAttachment.from_bytes(packed) == SdkAttachment(7, 1_700_000_000_123_456_789, b"0123456789abcdef")
    by_zenoh = b"".join(
        ext.z_serialize(part).to_bytes() for part in (ext.Int64(7), ext.Int64(1_700_000_000_123_456_789))
    )
    assert packed == by_zenoh + ext.z_serialize(b"0123456789abcdef").to_bytes()
    assert unpack_attachment(packed) == Attachment(7, 1_700_000_000_123_456_789, b"0123456789abcdef")


@pytest.mark.parametrize("data", [b"", b"x" * 32, b"x" * 34, struct.pack("<qqB16s", 1, 2, 15, b"g" * 16)])
def test_other_attachments_are_none(data):
    assert unpack_attachment(data) is None


def test_identifier_of_a_publisher_is_the_hash_of_its_token_low_half_first():
    low, high = 0x6001C324468D497F, 0x99AA06D3014798D8  # XXH3-128 of nothing, seed 0: test vector of its reference code
    assert gid("") == low.to_bytes(8, "little") + high.to_bytes(8, "little")
    assert len(gid(TALKER)) == 16


@pytest.mark.parametrize(("topic", "at_once"), [(ros.FRAMES, False), (ros.ODOMETRY, True)])
def test_what_comes_in_bursts_shares_batches(topic, at_once):
    """In a batch each they fill the queue of the sender when the reader pauses, and the next ones are lost."""
    asked = {}
    _declare_publisher(SimpleNamespace(declare_publisher=lambda _, **settings: asked.update(settings)), "key", topic)
    assert asked["express"] is at_once

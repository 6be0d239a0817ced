"""What keeps nodes and bridge apart is said in words."""

from __future__ import annotations

from hil_gateway.ros2.graph import TOKENS_MAX, Graph
from hil_gateway.ros2.wire import RosType, gid

ODOMETRY = RosType("nav_msgs/msg/Odometry", "RIHS01_3cc97dc7fb75")
STEERING = RosType("raptor_dbw_msgs/msg/SteeringCmd", "RIHS01_72266606c0bb")


def graph() -> Graph:
    return Graph("me", [("/raptor/steering_cmd", STEERING)], [("/av24/odometry", ODOMETRY)])


def token(kind: str, topic: str, of: RosType, node: str = "path_follower", session: str = "them") -> str:
    return f"@ros2_lv/0/{session}/0/3/{kind}/%/%/{node}/{topic.replace('/', '%')}/{of.dds}/{of.hash}/::,1:,:,:,,"


def test_nodes_that_fit_are_counted_and_cause_no_note():
    seen = graph()
    seen.change("@ros2_lv/0/them/0/0/NN/%/%/path_follower", True)
    seen.change(token("MP", "/raptor/steering_cmd", STEERING), True)
    seen.change(token("MS", "/av24/odometry", ODOMETRY), True)
    seen.change(token("MS", "/somewhere/else", STEERING), True)
    assert (seen.nodes, seen.notes) == (1, ())


def test_wrong_hash_of_a_command_is_said_with_node_topic_and_remedy_until_it_is_gone():
    seen = graph()
    wrong = token("MP", "/raptor/steering_cmd", RosType(STEERING.name, "RIHS01_00000000aaaa"))
    seen.change(wrong, True)
    (note,) = seen.notes
    assert note == (
        "/path_follower publishes /raptor/steering_cmd as raptor_dbw_msgs/msg/SteeringCmd RIHS01_00000000 and is not "
        "taken: the bridge has raptor_dbw_msgs/msg/SteeringCmd RIHS01_72266606; the definitions differ: set "
        "ros2.messages, or build the same message package"
    )
    seen.change(wrong, False)
    assert seen.notes == ()


def test_subscriber_of_humble_is_told_what_to_set():
    seen = graph()
    seen.change(token("MS", "/av24/odometry", RosType(ODOMETRY.name, "TypeHashNotSupported")), True)
    assert "expects /av24/odometry" in seen.notes[0]
    assert seen.notes[0].endswith("set ros2.type_hashes to false for Humble, to true for later ones")


def test_other_type_on_a_topic_of_ours():
    seen = graph()
    seen.change(token("MP", "/raptor/steering_cmd", RosType("std_msgs/msg/Float32", "RIHS01_7170d3d8f841")), True)
    assert seen.notes[0].endswith("; use that type")


def test_second_bridge_is_seen_and_the_own_tokens_are_not():
    seen = graph()
    seen.change("@ros2_lv/0/me/0/0/NN/%/%/av24_bridge", True)
    assert seen.notes == ()
    seen.change("@ros2_lv/0/them/0/0/NN/%/%/av24_bridge", True)
    assert seen.notes == ("another bridge is in this domain (session them)",)


def test_sender_is_known_by_its_identifier():
    seen = graph()
    text = token("MP", "/raptor/steering_cmd", STEERING)
    seen.change(text, True)
    assert seen.sender(gid(text)) == "/path_follower"
    assert seen.sender(b"?" * 16) == ""


def test_flood_of_tokens_is_bounded():
    seen = graph()
    for number in range(TOKENS_MAX + 10):
        seen.change(token("MP", f"/topic{number}", STEERING), True)
    assert seen.left_out == 10
    for rubbish in ("", "x" * 10_000, "@ros2_lv/0/a"):
        seen.change(rubbish, True)

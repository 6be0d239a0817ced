"""Hashes of message types, against those the packages themselves have; bytes that are not of a type."""

from __future__ import annotations

import random

import pytest

from hil_gateway.ros2.topics import COMMANDS
from hil_gateway.ros2.types import Types

HASHES = {
    "av24": """
        nav_msgs/Odometry 3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0
        can_msgs/Frame 0cdc7d15657573ee6ff151e5cc1943888301e370d957e2c077a154f4755fd976
        raptor_dbw_msgs/WheelSpeedReport 778fa273c5066babc766380773778355d136f278bdd5047894557265f3754e34
        raptor_dbw_msgs/SteeringReport 208c9f1c73050c9b43052ff4c31edc2bfcf3561ccadde57eebb9e448c494916a
        raptor_dbw_msgs/AcceleratorPedalReport 8ed2c6f6b4a9bd50181976468ebddb7fcc4226fd5ce6c4f6177c929ea623c5eb
        raptor_dbw_msgs/SteeringCmd 72266606c0bbda469d7504a11cbb10970055335f7d09ee364dc04ccd1b178ce5
        raptor_dbw_msgs/BrakeCmd 43e4bd0dcea5db83d40774b76c3be570fe2684793971d358af00cab5c84cea05
        raptor_dbw_msgs/AcceleratorPedalCmd ca742ce674fb0911e6c8689961d11677ee92e7393e51a2a608c82548a41d3920
        deep_orange_msgs/MiscReport d620e8104492a6a5d1ed2366ad862a58b4d03974be1b0902849109c66a8b8c6f
        raptor_dbw_msgs/Brake2Report 2974a57f7d49802ef11e46ff108e7d5cb6280e4b3c56befbf9e32e45bd4d6218
        raptor_dbw_msgs/SteeringExtendedReport 30b7d36b1d398854af4a2f7af5e947662f9a6d28537a4781b7c23b5f8b1734d6
        deep_orange_msgs/PtReport 39dc886b8be247444e096cb044c1742867e58265af7bbf3716ffd9a43e08a8fa
    """,
    "av21": """
        raptor_dbw_msgs/Brake2Report a6bb8446a087834b8bc45d9c9506c825e1852c65110a8ab737d74b0c001f4a88
        raptor_dbw_msgs/SteeringExtendedReport d223fd9fa7ffafc9be86ca5cda13d14e78ef947673e05689169ec19d2ed1a131
        deep_orange_msgs/PtReport 925236f5399759c59726d614d49767a3301924729ad08968edb5fa9e71d953f9
    """,
}
"""generation -> type and SHA-256 as the packages' own builds have them"""


@pytest.mark.parametrize("generation", HASHES)
def test_every_definition_has_the_hash_of_its_package(generation):
    types = Types(generation)
    for line in HASHES[generation].strip().splitlines():
        name, digest = line.split()
        assert types.of(name.replace("/", "/msg/")).hash == f"RIHS01_{digest}", name


def test_humble_has_no_hashes():
    assert Types("av24", hashes=False).of("nav_msgs/msg/Odometry").hash == "TypeHashNotSupported"


def test_bytes_that_are_no_message_are_none():
    types, rng = Types("av24"), random.Random(1)
    names = {topic.type for topics in COMMANDS.values() for topic in topics}
    for name in sorted(names):
        for length in range(100):
            for begin in (b"", b"\0\1\0\0", b"\0\0\0\0"):
                message = types.from_bytes(name, begin + rng.randbytes(length))
                assert message is None or isinstance(message, types[name])
        assert types.from_bytes(name, b"\0\1\0\0") is None

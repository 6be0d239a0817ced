"""A ROS 2 node over Zenoh, written from rmw_zenoh's description and the CDR standard alone: no code of the bridge.

It lists what the graph shows, echoes topics and publishes commands; bytes are taken apart by hand.
"""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import zenoh
from zenoh.handlers import RingChannel

HEADER = "time.sec:i time.nanosec:I frame_id:s"
TURN = "qx:d qy:d qz:d qw:d"
LAYOUTS: dict[str, str] = {
    "nav_msgs::msg::dds_::Odometry_": f"{HEADER} child:s x:d y:d z:d {TURN} pose_covariance:36d "
    "vx:d vy:d vz:d wx:d wy:d wz:d twist_covariance:36d",
    "sensor_msgs::msg::dds_::Imu_": f"{HEADER} {TURN} turn_covariance:9d wx:d wy:d wz:d rate_covariance:9d "
    "ax:d ay:d az:d acceleration_covariance:9d",
    "can_msgs::msg::dds_::Frame_": f"{HEADER} id:I is_rtr:? is_extended:? is_error:? dlc:B data:8B",
    "raptor_dbw_msgs::msg::dds_::WheelSpeedReport_": f"{HEADER} fl:f fr:f rl:f rr:f",
}
SIZES = {"d": 8, "f": 4, "i": 4, "I": 4, "?": 1, "B": 1, "b": 1}


def decode(dds_type: str, data: bytes) -> dict[str, Any]:
    """Fields of a message by its layout; every byte has to be accounted for."""
    assert data[:4] == b"\0\1\0\0"
    body, at, fields = data[4:], 0, {}
    for name, kind in (part.split(":") for part in LAYOUTS[dds_type].split()):
        if kind == "s":
            at += -at % 4
            (length,) = struct.unpack_from("<I", body, at)
            fields[name] = body[at + 4 : at + 4 + length - 1].decode()
            assert body[at + 3 + length] == 0
            at += 4 + length
            continue
        count, code = int(kind[:-1] or 1), kind[-1]
        at += -at % SIZES[code]
        values = struct.unpack_from(f"<{count}{code}", body, at)
        fields[name] = values if kind[:-1] else values[0]
        at += count * SIZES[code]
    assert at == len(body), (at, len(body))
    return fields


def encode(parts: Sequence[tuple[str, Any]]) -> bytes:
    """CDR of (code, value) pairs; "s" is a string."""
    body = b""
    for code, value in parts:
        body += bytes(-len(body) % (4 if code == "s" else SIZES[code]))
        text = code == "s"
        body += struct.pack("<I", len(value) + 1) + value.encode() + b"\0" if text else struct.pack(f"<{code}", value)
    return b"\0\1\0\0" + body


@dataclass(frozen=True)
class Echo:
    """A message as it arrived."""

    key: str
    dds_type: str
    data: bytes
    sequence: int
    source_ns: int
    gid: bytes
    received_ns: int

    @property
    def fields(self) -> dict[str, Any]:
        return decode(self.dds_type, self.data)


class Peer:
    """One node; `port` is the router's."""

    def __init__(self, port: int, node: str = "peer", domain: int = 0, mode: str = "peer") -> None:
        config: dict[str, Any] = {
            "mode": mode,
            "connect": {"endpoints": [] if mode == "router" else [f"tcp/127.0.0.1:{port}"]},
            "listen": {"endpoints": [f"tcp/127.0.0.1:{port if mode == 'router' else 0}"]},
            "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": True}},
            "timestamping": {"enabled": True},
        }
        self.session = zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
        self.domain, self.node, self._next_id = domain, node, 1
        self.zid = str(self.session.zid())
        self._seen: set[str] = set()
        self._watch = self.session.liveliness().declare_subscriber(
            f"@ros2_lv/{domain}/**", RingChannel(10_000), history=True
        )
        self._tokens = [self._token(f"0/0/NN/%/%/{node}")]
        self._publishers: dict[str, tuple[Any, int]] = {}

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self.session.close()

    def graph(self) -> set[str]:
        """All tokens of the domain but this node's own, as they have come and gone so far."""
        while (sample := self._watch.try_recv()) is not None:
            change = self._seen.add if sample.kind == zenoh.SampleKind.PUT else self._seen.discard
            change(str(sample.key_expr))
        return {token for token in self._seen if f"/{self.zid}/" not in token}

    def topics(self, kind: str = "MP") -> dict[str, tuple[str, str, str]]:
        """Topic -> (DDS type, hash, QoS), of all publishers or subscriptions: what `ros2 topic list -t` shows."""
        rows = (token.split("/") for token in self.graph() if f"/{kind}/" in token)
        return {row[9].replace("%", "/"): (row[10], row[11], row[12]) for row in rows}

    def subscribe(self, topic: str, dds_type: str, type_hash: str, qos: str = "::,10:,:,:,,") -> Any:
        self._endpoint("MS", topic, dds_type, type_hash, qos)
        key = f"{self.domain}/{topic.strip('/')}/{dds_type}/{type_hash}"
        return self.session.declare_subscriber(key, RingChannel(100_000))

    def publish(self, topic: str, dds_type: str, type_hash: str, data: bytes, source_ns: int | None = None) -> None:
        key = f"{self.domain}/{topic.strip('/')}/{dds_type}/{type_hash}"
        if key not in self._publishers:
            self._endpoint("MP", topic, dds_type, type_hash, "::,1:,:,:,,")
            self._publishers[key] = self.session.declare_publisher(key, express=True), 0
        publisher, sequence = self._publishers[key]
        self._publishers[key] = publisher, sequence + 1
        stamp = time.time_ns() if source_ns is None else source_ns
        gid = (self.zid + "0" * 32)[:16].encode()
        publisher.put(data, attachment=struct.pack("<qqB16s", sequence + 1, stamp, 16, gid))

    def _endpoint(self, kind: str, topic: str, dds_type: str, type_hash: str, qos: str) -> None:
        name = topic.replace("/", "%")
        self._tokens.append(
            self._token(f"0/{self._next_id}/{kind}/%/%/{self.node}/{name}/{dds_type}/{type_hash}/{qos}")
        )
        self._next_id += 1

    def _token(self, rest: str) -> Any:
        return self.session.liveliness().declare_token(f"@ros2_lv/{self.domain}/{self.zid}/{rest}")


def echoes(subscriber: Any) -> Iterator[Echo]:
    """What has arrived at a subscriber."""
    while (sample := subscriber.try_recv()) is not None:
        attachment = sample.attachment.to_bytes()
        sequence, source_ns, length, gid = struct.unpack("<qqB16s", attachment)
        assert length == 16
        key = str(sample.key_expr)
        yield Echo(key, key.split("/")[-2], sample.payload.to_bytes(), sequence, source_ns, gid, time.time_ns())

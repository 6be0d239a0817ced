"""Names and bytes of `rmw_zenoh`: data keys, liveliness tokens, QoS, attachments. Pure.

Source: ros2/rmw_zenoh, docs/design.md and rmw_zenoh_cpp/src/detail (liveliness_utils, attachment_helpers, qos), as of
Humble 0.1.2, Jazzy 0.2.4, Kilted 0.6 and later. An older attachment had text keys; it is not understood.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from struct import Struct

ADMIN_SPACE = "@ros2_lv"
"""first chunk of every token; wildcards do not match it, so it has to be written out"""
NO_TYPE_HASH = "TypeHashNotSupported"
"""in the place of the hash where the distribution (Humble) has none"""
GID_BYTES = 16
TOKEN_CHARS_MAX = 2048
"""of a token that is looked at: names in ROS have at most 255 characters"""
DEFAULT_DEPTH = 42
_ATTACHMENT = Struct(f"<qqB{GID_BYTES}s")


class Kind(StrEnum):
    """What a token stands for."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"


@dataclass(frozen=True, slots=True)
class Qos:
    """The part of a QoS profile that differs between our topics; keep last, no deadline, no lifespan, automatic."""

    depth: int = 10
    best_effort: bool = False
    transient_local: bool = False

    def encoded(self) -> str:
        """`reliability:durability:history,depth:deadline:lifespan:liveliness,lease`, empty where it is the default."""
        reliability, durability = "2" if self.best_effort else "", "1" if self.transient_local else ""
        depth = "" if self.depth == DEFAULT_DEPTH else str(self.depth)
        return f"{reliability}:{durability}:,{depth}:,:,:,,"


@dataclass(frozen=True, slots=True)
class RosType:
    """A message type as the wire names it."""

    name: str
    """pkg/msg/Name"""
    hash: str

    @property
    def dds(self) -> str:
        """pkg::msg::dds_::Name_"""
        package, _, name = self.name.split("/")
        return f"{package}::msg::dds_::{name}_"


@dataclass(frozen=True, slots=True)
class Node:
    """A node of one Zenoh session."""

    domain: int
    session: str
    """zid as text"""
    name: str
    id: int = 0

    @property
    def token(self) -> str:
        """Its liveliness token: no enclave, root namespace."""
        return f"{ADMIN_SPACE}/{self.domain}/{self.session}/{self.id}/{self.id}/{Kind.NODE}/%/%/{self.name}"

    def endpoint_token(self, endpoint_id: int, kind: Kind, topic: str, of: RosType, qos: Qos) -> str:
        """Token of a publisher or subscription of this node; `endpoint_id` is unique in the session."""
        who = f"{ADMIN_SPACE}/{self.domain}/{self.session}/{self.id}/{endpoint_id}/{kind}/%/%/{self.name}"
        return f"{who}/{topic.replace('/', '%')}/{of.dds}/{of.hash}/{qos.encoded()}"


def data_key(domain: int, topic: str, of: RosType) -> str:
    """Key that the messages of a topic are published on."""
    return f"{domain}/{topic.strip('/')}/{of.dds}/{of.hash}"


@dataclass(frozen=True, slots=True)
class Token:
    """What a token says; the fields of an endpoint are empty for a node."""

    session: str
    kind: str
    node: str
    """with its namespace"""
    topic: str = ""
    dds_type: str = ""
    hash: str = ""


def parse_token(text: str) -> Token | None:
    """None for what is no token of a node, publisher or subscription. Further chunks, as Lyrical adds, are accepted."""
    chunks = text.split("/") if len(text) <= TOKEN_CHARS_MAX else []
    if len(chunks) < 9 or chunks[0] != ADMIN_SPACE:
        return None
    session, kind, namespace, name = chunks[2], chunks[5], chunks[7].replace("%", "/"), chunks[8]
    node = f"{namespace.rstrip('/')}/{name}"
    if kind == Kind.NODE:
        return Token(session, kind, node)
    if kind not in (Kind.PUBLISHER, Kind.SUBSCRIPTION) or len(chunks) < 13:
        return None
    return Token(session, kind, node, chunks[9].replace("%", "/"), chunks[10], chunks[11])


def gid(token: str) -> bytes:
    """Identifier of a publisher: XXH3-128 of its token, both halves little endian, low half first."""
    import xxhash

    return bytes(xxhash.xxh3_128_digest(token.encode())[::-1])


@dataclass(frozen=True, slots=True)
class Attachment:
    """What goes with every message; `rmw_zenoh` drops one that comes without."""

    sequence: int
    """counts from 1"""
    source_ns: int
    """Unix time at which it was published"""
    gid: bytes

    def packed(self) -> bytes:
        """33 bytes."""
        return _ATTACHMENT.pack(self.sequence, self.source_ns, GID_BYTES, self.gid)


def unpack_attachment(data: bytes) -> Attachment | None:
    """None where it has another form."""
    if len(data) != _ATTACHMENT.size:
        return None
    sequence, source_ns, length, sender = _ATTACHMENT.unpack(data)
    return Attachment(sequence, source_ns, sender) if length == GID_BYTES else None

"""Who else is in the ROS graph, and what keeps them and the bridge apart. Pure.

A type with another hash is another key: nothing arrives and nothing says so. So the tokens of the others are compared.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from hil_gateway.ros2.topics import NODE
from hil_gateway.ros2.wire import NO_TYPE_HASH, Kind, RosType, Token, gid, parse_token

BRIDGE = f"/{NODE}"
TOKENS_MAX = 4096
"""of other nodes that are kept"""
NAMES_MAX = 64
"""characters of a node's name that are kept"""


class Graph:
    """Takes tokens as they come and go; `notes` says in words what is wrong now."""

    def __init__(
        self, session: str, taken: Iterable[tuple[str, RosType]], published: Iterable[tuple[str, RosType]]
    ) -> None:
        """`session`: the bridge's own; `taken`, `published`: topic and type of its subscriptions and publishers."""
        self._session = session
        self._expected = {Kind.PUBLISHER: _by_topic(taken), Kind.SUBSCRIPTION: _by_topic(published)}
        self._tokens: dict[str, Token] = {}
        self.left_out = 0
        """tokens beyond `TOKENS_MAX`"""

    def change(self, text: str, appeared: bool) -> None:
        """A token that came or went; what is none is left aside."""
        if not appeared:
            self._tokens.pop(text, None)
            return
        token = parse_token(text)
        if token is None or token.session == self._session:
            return
        if len(self._tokens) >= TOKENS_MAX:
            self.left_out += 1
        else:
            self._tokens[text] = token

    @property
    def nodes(self) -> int:
        """Other nodes."""
        return sum(token.kind == Kind.NODE for token in self._tokens.values())

    @property
    def notes(self) -> tuple[str, ...]:
        """One line for each thing that is wrong."""
        return tuple(dict.fromkeys(note for token in self._tokens.values() if (note := self._note(token))))

    def sender(self, sender_gid: bytes) -> str:
        """Name of the node that publishes with this identifier; empty where its token is not known."""
        found = (t.node for text, t in self._tokens.items() if t.kind == Kind.PUBLISHER and gid(text) == sender_gid)
        return next(found, "")[:NAMES_MAX]

    def _note(self, token: Token) -> str:
        if token.kind == Kind.NODE:
            return f"another bridge is in this domain (session {token.session})" if token.node == BRIDGE else ""
        ours = self._expected[Kind(token.kind)].get(token.topic)
        if ours is None or any((token.dds_type, token.hash) == (of.dds, of.hash) for of in ours):
            return ""
        does, effect = ("publishes", "is not taken") if token.kind == Kind.PUBLISHER else ("expects", "gets nothing")
        name = token.dds_type.replace("::dds_::", "/").replace("::", "/").rstrip("_")
        theirs = f"{token.node} {does} {token.topic} as {name} {_short(token.hash)}"
        wanted = " or ".join(f"{of.name} {_short(of.hash)}" for of in ours)
        return f"{theirs} and {effect}: the bridge has {wanted}; {_remedy(token, ours)}"


def _by_topic(endpoints: Iterable[tuple[str, RosType]]) -> Mapping[str, tuple[RosType, ...]]:
    found: dict[str, tuple[RosType, ...]] = {}
    for topic, of in endpoints:
        found[topic] = (*found.get(topic, ()), of)
    return found


def _short(type_hash: str) -> str:
    return type_hash if type_hash == NO_TYPE_HASH else type_hash[:15]


def _remedy(token: Token, ours: tuple[RosType, ...]) -> str:
    if (token.hash == NO_TYPE_HASH) != (ours[0].hash == NO_TYPE_HASH):
        return "set ros2.type_hashes to false for Humble, to true for later ones"
    if token.dds_type in {of.dds for of in ours}:
        return "the definitions differ: set ros2.messages, or build the same message package"
    return "use that type"

"""Message types of ROS 2 with their hashes and bytes (CDR), by `rosbags`; no ROS installation is needed."""

from __future__ import annotations

from typing import Any

from hil_gateway.process.errors import InputError
from hil_gateway.ros2.definitions import COMMON, GENERATIONS
from hil_gateway.ros2.wire import NO_TYPE_HASH, RosType


class Types:
    """Types of one generation of the car's messages; `types[name]` is the class of `pkg/msg/Name`."""

    def __init__(self, generation: str, *, hashes: bool = True) -> None:
        """`hashes`: whether the distribution has type hashes; Humble has none.

        Raises:
            InputError: the extra `ros2` is not installed.
        """
        try:
            from rosbags.typesys import Stores, get_types_from_msg, get_typestore
        except ModuleNotFoundError:
            raise InputError("rosbags is not installed: pip install 'hil-gateway[ros2]'") from None
        self._hashes = hashes
        self._store = get_typestore(Stores.LATEST)
        for name, fields in {**COMMON, **GENERATIONS[generation]}.items():
            self._store.register(get_types_from_msg(fields.replace("; ", "\n"), name))

    def __getitem__(self, name: str) -> Any:
        return self._store.types[name]

    def of(self, name: str) -> RosType:
        """The type as it stands in keys and tokens."""
        return RosType(name, self._store.hash_rihs01(name) if self._hashes else NO_TYPE_HASH)

    def definition(self, name: str) -> str:
        """Fields of the type and of those it holds, as bags store them."""
        return str(self._store.generate_msgdef(name, ros_version=2)[0])

    def to_bytes(self, name: str, message: Any) -> bytes:
        """CDR, little endian, with its header of four bytes."""
        return bytes(self._store.serialize_cdr(message, name))

    def from_bytes(self, name: str, data: bytes) -> Any | None:
        """The message; None where the bytes are no CDR of this type."""
        from rosbags.serde import SerdeError

        try:
            return self._store.deserialize_cdr(data, name)
        except (SerdeError, ValueError, IndexError, KeyError, TypeError, OverflowError, AssertionError):
            return None

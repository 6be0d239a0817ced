"""Definitions of the messages of a bag: what the bag says, else what their packages are known to have said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from estimator.drive_log.bag.definitions import KNOWN
from estimator.drive_log.bag.layout import Definitions, NoSuchMessageError, walk
from hil_gateway.process.errors import InputError
from hil_gateway.session.files.reader import Stream

SAMPLES = 50
"""messages of a kind that a generation must read"""
MESSAGE_FORMATS = ("ros2msg", "ros2idl")


@cache
def _rosbags() -> Any:
    try:
        import rosbags.typesys
    except ModuleNotFoundError:
        raise InputError("bags need the package rosbags: pip install 'hil-gateway[ros2]'") from None
    return rosbags.typesys


@cache
def standard() -> dict[str, Any]:
    """What every ROS distribution has."""
    typesys = _rosbags()
    return dict(typesys.get_typestore(typesys.Stores.ROS2_HUMBLE).fielddefs)


def full_name(kind: str) -> str:
    """`pkg/msg/Name`, also of `pkg/Name`."""
    package, _, name = kind.partition("/")
    return kind if name.startswith("msg/") else f"{package}/msg/{name}"


def written(stream: Stream) -> Definitions | None:
    """The definitions a bag has of one topic; None where it has none, or none that can be read."""
    if stream.schema_encoding not in MESSAGE_FORMATS or not stream.definition:
        return None
    typesys, text = _rosbags(), stream.definition.decode("utf-8", "replace")
    try:
        if stream.schema_encoding == "ros2idl":
            parsed = typesys.get_types_from_idl(text)
        else:
            parsed = typesys.get_types_from_msg(text, full_name(stream.kind))
    except Exception:  # its parser raises of every kind
        return None
    return {**standard(), **parsed}


@cache
def _generation(package: str, name: str) -> dict[str, Any]:
    parsed = dict(standard())
    for kind, fields in KNOWN[package][name].items():
        parsed |= _rosbags().get_types_from_msg(fields.replace("; ", "\n"), kind)
    return parsed


def of_generation(package: str, samples: Mapping[str, Sequence[bytes]]) -> tuple[str, Definitions]:
    """The generation of a package that reads most of the messages; the standard types for any other package."""
    generations = list(KNOWN.get(package, ()))
    if not generations:
        return "", standard()
    best = max(generations, key=lambda name: _read(_generation(package, name), samples))
    return best, _generation(package, best)


def _read(definitions: Definitions, samples: Mapping[str, Sequence[bytes]]) -> int:
    count = 0
    for kind, messages in samples.items():
        for data in messages:
            try:
                walk(data, kind, definitions)
            except NoSuchMessageError:
                continue
            count += 1
    return count

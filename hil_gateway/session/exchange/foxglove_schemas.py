"""The `foxglove.*` messages an export holds, as JSON schemas: names and units as docs.foxglove.dev/docs/sdk/schemas.

Every type is written out where it is used: Foxglove's reader follows no references.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

Schema = Mapping[str, Any]
NUMBER, INTEGER, TEXT, FLAG = ({"type": name} for name in ("number", "integer", "string", "boolean"))


def _object(**properties: Schema) -> Schema:
    return {"type": "object", "properties": properties}


def _list(of: Schema) -> Schema:
    return {"type": "array", "items": of}


TIME = _object(sec=INTEGER, nsec=INTEGER)
VECTOR = _object(x=NUMBER, y=NUMBER, z=NUMBER)
QUATERNION = _object(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
POSE = _object(position=VECTOR, orientation=QUATERNION)
COLOUR = _object(r=NUMBER, g=NUMBER, b=NUMBER, a=NUMBER)
LINE = _object(
    type=INTEGER, pose=POSE, thickness=NUMBER, scale_invariant=FLAG, points=_list(VECTOR), color=COLOUR,
    colors=_list(COLOUR), indices=_list(INTEGER),
)  # fmt: skip
CUBE = _object(pose=POSE, size=VECTOR, color=COLOUR)
ENTITY = _object(
    timestamp=TIME, frame_id=TEXT, id=TEXT, lifetime=TIME, frame_locked=FLAG,
    metadata=_list(_object(key=TEXT, value=TEXT)), cubes=_list(CUBE), lines=_list(LINE),
)  # fmt: skip
SCHEMAS: Mapping[str, Schema] = {
    "foxglove.LocationFix": _object(
        timestamp=TIME, frame_id=TEXT, latitude=NUMBER, longitude=NUMBER, altitude=NUMBER,
        position_covariance=_list(NUMBER), position_covariance_type=INTEGER,
    ),
    "foxglove.FrameTransform": _object(
        timestamp=TIME, parent_frame_id=TEXT, child_frame_id=TEXT, translation=VECTOR, rotation=QUATERNION
    ),
    "foxglove.SceneUpdate": _object(
        deletions=_list(_object(timestamp=TIME, type=INTEGER, id=TEXT)), entities=_list(ENTITY)
    ),
    "foxglove.Log": _object(timestamp=TIME, level=INTEGER, message=TEXT, name=TEXT, file=TEXT, line=INTEGER),
}  # fmt: skip
"""schema name -> what a message holds"""


def schema_text(name: str) -> bytes:
    """The schema as stored in a file."""
    return json.dumps({"title": name, **SCHEMAS[name]}).encode()

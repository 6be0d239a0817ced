"""Every field of every message has a bound, so that what anybody sends is small and what is computed of it finite."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from hil_gateway.bus.topics import TOPICS, Topic

LIMITS = {
    "string": ("maxLength", "enum", "const"),
    "number": ("minimum", "exclusiveMinimum"),
    "integer": ("maximum", "exclusiveMaximum", "enum", "const"),
    "array": ("maxItems",),
    "object": ("properties", "maxProperties"),
}
"""type of JSON -> keys of its schema of which one bounds it"""


def unbounded(schema: dict[str, Any], known: dict[str, Any], place: str = "") -> Iterator[str]:
    """Places in a schema where a value of any size passes."""
    if "$ref" in schema:
        schema = known[schema["$ref"].rpartition("/")[2]]
    limits = LIMITS.get(schema.get("type", ""), ())
    if limits and not set(limits) & set(schema):
        yield place
    inner = [("|", part) for key in ("anyOf", "allOf") for part in schema.get(key, ())]
    inner += [("[]", part) for part in (schema.get("items"), *schema.get("prefixItems", ())) if part]
    inner += [(f".{name}", part) for name, part in schema.get("properties", {}).items()]
    inner += [(f".{key}", schema[key]) for key in ("additionalProperties", "propertyNames") if schema.get(key)]
    for name, part in inner:
        yield from unbounded(part, known, place + name)


@pytest.mark.promise("D4")
@pytest.mark.parametrize("topic", TOPICS, ids=str)
def test_every_field_of_a_message_has_a_bound(topic: Topic[Any]) -> None:
    schema = topic.message.model_json_schema()
    assert list(unbounded(schema, schema.get("$defs", {}))) == []

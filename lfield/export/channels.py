"""Messages with the channels that they belong to, independent of a file format. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from msgspec import Struct, field

JsonSchema = Mapping[str, Any]

#: The largest time that is written, in nanoseconds since 1970.
_MAX_TIME = 2**63 - 1


class MessageSchema(Struct, frozen=True):
    """A JSON schema with its name for readers."""

    name: str
    json: JsonSchema


class Channel(Struct, frozen=True, eq=False):
    """A topic with the schema of its messages; every object is a channel of its own."""

    topic: str
    schema: MessageSchema
    metadata: Mapping[str, str] = field(default_factory=dict)


class ChannelMessage(NamedTuple):
    """A message at a time in seconds since 1970.

    `data` becomes JSON: a mapping of texts, numbers, booleans, lists and further mappings.
    """

    channel: Channel
    time: float
    data: Mapping[str, Any]


def nanoseconds(time: float) -> int:
    """A time in nanoseconds since 1970, as far as it can be written."""
    return min(max(0, round(time * 1e6) * 1000), _MAX_TIME) if math.isfinite(time) else 0


def timestamp(time: float) -> dict[str, int]:
    """A time as in Foxglove's schemas; also a duration."""
    seconds, remainder = divmod(nanoseconds(time), 1_000_000_000)
    return {"sec": seconds, "nsec": remainder}


def topic_part(name: str) -> str:
    """A name as a part of a topic: AGENT.FIELD becomes AGENT/FIELD.

    Readers take a period for the beginning of a field's name.
    """
    parts = name.split(".")
    return "/".join("".join(c if c.isalnum() or c in "_-" else "_" for c in part) or "_" for part in parts)

"""Events as JSON data, as of `lfield events --json`."""

from __future__ import annotations

import json
from typing import Any

import msgspec

from lfield.operator.dashboard.event_feed import FeedNotice
from lfield.operator.dashboard.timeline.event_timeline import DatedEvent
from lfield.wire.subscription_messages import as_fields


def event_data(item: DatedEvent | FeedNotice) -> dict[str, Any]:
    """A JSON object as in `events.md`, with the host and the merged time.

    NaN and infinities are null. A notice becomes an object of the kind 'lost'.
    """
    if isinstance(item, FeedNotice):
        return {"host": item.host, "kind": "lost", "lost": item.lost, "reason": item.text}
    cause = None if item.cause is None else item.cause._asdict()
    return {
        "host": item.host,
        "incarnation": item.incarnation,
        "time": item.time,
        "within": item.within,
        "tick": item.event.tick,
        "caused_by": cause,
        **as_fields(item.event),
    }


def event_json(item: DatedEvent | FeedNotice) -> str:
    """The object as one line in ASCII: other characters may be control sequences for a terminal."""
    return json_line(event_data(item))


def json_line(whole: dict[str, Any]) -> str:
    """JSON data as one line in ASCII."""
    text = msgspec.json.encode(whole).decode()
    return text if text.isascii() else json.dumps(msgspec.json.decode(text), separators=(",", ":"))

"""The subscription protocol for the events of a host: request, batches, acknowledgements.

The subscriber controls the flow: a host sends at most WINDOW batches beyond the last acknowledged one, so a
subscriber that stops reading uses a bounded number of bytes of its host. Messages as in `messages`.
"""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta, Struct, to_builtins

from lfield.wire.events import Event
from lfield.wire.fields import Count, Duration, Label, Moment, Ordinal
from lfield.wire.observer_messages import Status

#: The most events of a batch; their bytes are also bounded (`lfield.host.events`).
MAX_EVENTS = 1024

#: Maximum telemetry rate for each device and agent, per second.
MAX_RATE = 20.0

#: The most batches in flight without an acknowledgement.
WINDOW = 8


class Subscribe(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=40):
    """From an observer: subscribe to events. A second subscription on a link replaces the first.

    `incarnation` 0: from now on. The present incarnation of the host (its `Hello` has it): all stored states
    after number `after`. Another one: all stored states of this incarnation. `telemetry` is the maximum rate
    for each device and agent in 1/s; 0 for never. Answered by `EventBatch`, the first one at once. `once`:
    the answer is one batch with a snapshot and without events, and no subscription. The directory in the
    snapshot has the attributes of agents of other hosts only with `directory`.
    """

    incarnation: Count = 0
    after: Ordinal = 0
    telemetry: Annotated[float, Meta(ge=0.0, le=MAX_RATE)] = 0.0
    once: bool = False
    directory: bool = False


class EventBatch(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=41):
    """Events: the `batch` counts from 1 since the Subscribe.

    Its states are ordered by number, and begin after number `after`; the host's last state was `latest` when
    the batch was sent, at `now` (Unix time) and `up` (seconds of its monotonic clock). `lost` counts by kind
    the events dropped for this subscriber since the previous batch; for states (as 'state'), these are the
    states whose numbers are missing, from the previous batch to `after` and between the states of this batch.
    `snapshot` is the state of the host just after `latest`: in the answer to a request for a snapshot `once`,
    in the first batch for a new subscriber, and in a batch without states before states are lost.
    """

    incarnation: Count
    batch: Ordinal
    now: Moment
    up: Duration
    after: Ordinal
    latest: Ordinal
    events: Annotated[list[Event], Meta(max_length=MAX_EVENTS)]
    lost: Annotated[dict[Label, Count], Meta(max_length=64)] = {}
    snapshot: Status | None = None


class EventAck(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=42):
    """From an observer: it has processed events up to a batch. At most WINDOW batches are sent beyond it."""

    batch: Ordinal


SubscriptionMessage = Subscribe | EventBatch | EventAck


def as_fields(event: Event) -> dict[str, Any]:
    """An event as named fields: number, at, up, cause, kind, and the fields of its kind; for JSON."""
    fields = {name: to_builtins(getattr(event.what, name)) for name in event.what.__struct_fields__}
    head = {"number": event.number, "at": event.at, "up": event.up, "cause": event.cause}
    return {**head, "kind": event.kind, **fields}

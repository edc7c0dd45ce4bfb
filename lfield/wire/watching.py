"""How somebody follows the events of a host: what a watcher asks and hears, and says that it has seen.

The watcher decides how much may be on its way: a host sends no more than WINDOW batches beyond the last one
that was seen, so one that stops reading costs its host a bounded number of bytes. Messages as in `messages`.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from lfield.wire.events import Event
from lfield.wire.fields import Age, Count, Label, Moment, Ordinal
from lfield.wire.observing import Status

#: The most events of a batch; their bytes are bounded too (`lfield.host.sight`).
MAX_EVENTS = 1024

#: How often a second a watcher may be told of one device or agent, at most.
MAX_RATE = 20.0

#: So many batches may be on their way to a watcher that it has not yet said that it has seen.
WINDOW = 8


class Watch(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=40):
    """From an observer: tell me what happens from now on. A second one on a link takes the first one's place.

    `incarnation` 0: from now on. That of this life of the host (its `Hello` has it): all states after number
    `after` that it still has. Another one: all states of this life that it still has. `telemetry` is how
    often a second each device and agent is told of, at most; 0 for never. Answered by `Events`, the first
    one at once.
    """

    incarnation: Count = 0
    after: Ordinal = 0
    telemetry: Annotated[float, Meta(ge=0.0, le=MAX_RATE)] = 0.0


class Events(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=41):
    """What happened: the `batch` counts from 1 since the Watch.

    Its states are in the order of their numbers, and begin after number `after`; the host's last one was
    `latest` when this was sent, at `now` (Unix time) and `up` (seconds of its monotonic clock). `lost` says
    by kind how many events this watcher will never hear of, since the batch before; of states (as 'state')
    these are the ones whose numbers are missing, from the batch before to `after` and between its states.
    `snapshot` is how the host was just after `latest`: in the first batch of whoever knew nothing before, and
    in one without states before states are lost.
    """

    incarnation: Count
    batch: Ordinal
    now: Moment
    up: Age
    after: Ordinal
    latest: Ordinal
    events: Annotated[list[Event], Meta(max_length=MAX_EVENTS)]
    lost: Annotated[dict[Label, Count], Meta(max_length=64)] = {}
    snapshot: Status | None = None


class Seen(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=42):
    """From an observer: it has read up to that batch. At most WINDOW are sent beyond it."""

    batch: Ordinal


WatchMessage = Watch | Events | Seen

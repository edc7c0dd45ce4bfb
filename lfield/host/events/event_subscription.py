"""One subscription to a host's events: which batches of states and telemetry are sent, and when. Sans-IO.

A subscriber receives every state in order as long as the log has it. A slow subscriber is not served from the
oldest end, where it would lose more with every batch: it receives the rare events and the counts of the lost
events, and continues with live events. Telemetry is sent when there is room and no state is pending: only the
newest value of each device and agent, with a count of the replaced values. At most WINDOW batches are in
flight; a subscriber that does not read costs its host only this bookkeeping.

On a slow path, batches leave most of the measured rate to other messages (`path_rate`). At most one batch
with telemetry is in flight, and after a batch that was acknowledged late there is a pause of several times
the delay beyond the round trip.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping

from lfield.host.events.event_log import EventLog, size_of, stamped_event
from lfield.host.events.path_rate import PathRate
from lfield.wire.events import Event, TelemetryEvent
from lfield.wire.observer_messages import Status
from lfield.wire.subscription_messages import MAX_EVENTS, WINDOW, EventBatch, Subscribe

#: Maximum bytes of the events of a batch, unless one event alone has more; and of the first batch. The limit
#: doubles with each acknowledgement on a path that is not slow: the first batches do not fill a slow path.
BATCH_BYTES, FIRST_BATCH_BYTES = 48 << 10, 4 << 10
#: Minimum seconds between two batches; and the maximum, after which an empty batch shows that the host lives.
MIN_INTERVAL, QUIET_INTERVAL = 0.05, 1.0
#: After telemetry that was acknowledged late, the pause as a multiple of the delay, and its maximum in
#: seconds. The gain of the smoothed round trip for samples above it.
REST, LONGEST_REST, CREEP = 8.0, 10.0, 1 / 64
#: The seconds without an acknowledgement after which a subscriber is dropped.
READ_TIMEOUT = 60.0
#: A telemetry sample: by subject, a value that changes with the content, and the content.
TelemetrySample = Mapping[str, tuple[object, TelemetryEvent]]


class EventSubscription:
    """A subscription by `request`, received `uptime` seconds after the start of the host.

    `incarnation` is that of the host. All times are seconds since the start of the host.
    """

    def __init__(self, event_log: EventLog, incarnation: int, request: Subscribe, uptime: float) -> None:
        self._event_log, self._incarnation = event_log, incarnation
        if request.incarnation == 0:
            self._after = event_log.latest
        else:
            self._after = min(request.after, event_log.latest) if request.incarnation == incarnation else 0
        #: The newest state when the subscription started or fell behind; and the state after which it
        #: receives frequent events.
        self._caught_up_at, self._frequent_after = event_log.latest, 0
        self._snapshot = request.incarnation != incarnation or self._after < event_log.last_dropped
        #: Whether the last batch was a snapshot.
        self._last_snapshot = False
        self._batch = self._acknowledged = 0
        self._lost: Counter[str] = Counter()
        self._pending_telemetry: dict[str, Event] = {}
        self._known: dict[str, object] = {}
        self._sample_interval = 1.0 / request.telemetry if request.telemetry else 0.0
        #: The time when telemetry is sampled next for this subscription, None for never.
        self.sample_due: float | None = uptime if self._sample_interval else None
        #: The times at which the unacknowledged batches were sent; the batch of them with telemetry, 0 for
        #: none; the round trip in seconds; and the time when telemetry may be sent again.
        self._sent: dict[int, float] = {}
        #: For each of these batches, the bytes that the link had carried for subscriptions before it.
        self._positions: dict[int, int] = {}
        #: The bytes of the last batch whose size is known.
        self._size, self._path, self._limit = 0, PathRate(), FIRST_BATCH_BYTES
        self._full, self._is_full = 0, False
        self._round_trip: float | None = None
        self._rest_until = uptime
        #: The time when the next batch may be sent.
        self.next_batch_at = uptime
        self._last_ack_at = uptime

    def resume_from(self, before: EventSubscription) -> None:
        """Continue a subscription that is renewed: its unreported losses are still to be reported."""
        self._lost.update(before._lost)

    def on_ack(self, batch: int, uptime: float, position: int = 0) -> None:
        """The subscriber has processed batches up to this one; see `on_sending` for `position`."""
        if not self._acknowledged < batch <= self._batch:
            return
        self._acknowledged, self._last_ack_at = batch, uptime
        if batch in self._positions:
            self._size = self._positions.get(batch + 1, position) - self._positions[batch]
            self._path.add(self._size, uptime - self._sent[batch])
            if batch == self._batch:
                self.next_batch_at = self._sent[batch] + self._interval
        self._limit = self._path.batch_limit(min(2 * self._limit, BATCH_BYTES))
        if self._full and self._full <= batch:
            self._rest_until, self._full = uptime + self._pause_after(uptime - self._sent[self._full]), 0
        else:
            took = uptime - self._sent[batch]
            before = took if self._round_trip is None else self._round_trip
            self._round_trip = min(took, before + CREEP * (took - before))
        self._sent = {number: at for number, at in self._sent.items() if number > batch}
        self._positions = {number: at for number, at in self._positions.items() if number > batch}

    def _pause_after(self, took: float) -> float:
        """The pause of telemetry after a batch whose acknowledgement took this number of seconds."""
        if self._round_trip is not None:
            return min(LONGEST_REST, REST * max(0.0, took - self._round_trip))
        # The next batch has no telemetry and measures the round trip.
        return QUIET_INTERVAL if took > MIN_INTERVAL else 0.0

    def has_gone(self, uptime: float) -> bool:
        """Whether the subscriber has stopped reading."""
        return self._acknowledged < self._batch and uptime - self._last_ack_at >= READ_TIMEOUT

    @property
    def due(self) -> float:
        """The time when `next_batch` is due without further events, or `has_gone` becomes true."""
        if self._is_behind:
            return self._last_ack_at + READ_TIMEOUT
        if not self._batch or self._snapshot or self._event_log.latest > self._after:
            return self.next_batch_at
        latest_time = self.next_batch_at - MIN_INTERVAL + QUIET_INTERVAL
        return (
            latest_time
            if self._full or not self._pending_telemetry
            else min(latest_time, max(self.next_batch_at, self._rest_until))
        )

    @property
    def _is_behind(self) -> bool:
        return self._batch - self._acknowledged >= WINDOW

    @property
    def _interval(self) -> float:
        """Seconds between a batch of the last known size and the next one."""
        return max(MIN_INTERVAL, self._path.pause(self._size))

    def on_sample(self, values: TelemetrySample, at: float, uptime: float, stamp: int = 0) -> None:
        """Process a telemetry sample with the timestamp `stamp`; changed values are pending from then on."""
        if self.sample_due is None or uptime < self.sample_due:
            return
        self.sample_due = max(self.sample_due + self._sample_interval, uptime)
        latest = self._event_log.latest
        for key, (version, content) in values.items():
            if self._known.get(key) == version:
                continue
            self._known[key] = version
            event = stamped_event(latest, at, uptime, 0, content, stamp)
            if key in self._pending_telemetry:
                self._lost[event.kind] += 1
            self._pending_telemetry[key] = event

    def next_batch(self, at: float, uptime: float, snapshot: Callable[[], Status]) -> EventBatch | None:
        """The batch to send now, None for none yet."""
        if self._is_behind or uptime < self.due:
            return None
        if self._acknowledged == self._batch:
            # The wait for the acknowledgement begins here.
            self._last_ack_at = uptime
        after, events, status = self._after, list[Event](), None
        # Even a subscriber that reads slowly receives a batch after a snapshot.
        if self._snapshot or (not self._last_snapshot and self._skip_lost()):
            status, self._snapshot, self._last_snapshot = snapshot(), False, True
        else:
            (after, events), self._last_snapshot = self._next_events(uptime), False
        self._batch += 1
        self._sent[self._batch] = uptime
        if self._is_full:
            self._full, self._is_full = self._batch, False
        self.next_batch_at = uptime + self._interval
        lost, self._lost = dict(self._lost), Counter()
        return EventBatch(
            self._incarnation, self._batch, at, uptime, after, self._event_log.latest, events, lost, status
        )

    def on_sending(self, position: int) -> None:
        """The last batch is sent on a link that has carried `position` bytes for subscriptions."""
        self._positions[self._batch] = position

    def final_batch(self, at: float, uptime: float) -> EventBatch:
        """The last batch of a dropped subscription: its losses until now."""
        for event in self._pending_telemetry.values():
            self._lost[event.kind] += 1
        lost, self._lost = dict(self._lost), Counter()
        self._pending_telemetry.clear()
        self._batch += 1
        return EventBatch(
            self._incarnation, self._batch, at, uptime, self._after, self._event_log.latest, [], lost
        )

    def _skip_lost(self) -> bool:
        """Whether the log has dropped the next events: then continue with live events."""
        stream = self._event_log
        if stream.last_dropped <= max(self._after, self._caught_up_at):
            return False
        self._caught_up_at = self._frequent_after = stream.latest
        return True

    def _next_events(self, uptime: float) -> tuple[int, list[Event]]:
        """The next states, and the number that they follow; telemetry if there is room."""
        stream, before = self._event_log, self._after
        events, size = stream.after(before, MAX_EVENTS, self._limit, self._frequent_after)
        self._after = events[-1].number if events else stream.latest
        if missing := self._after - before - len(events):
            self._lost["state"] += missing
        after = events[0].number - 1 if events else self._after
        if self._after == stream.latest and not self._full and uptime >= self._rest_until:
            self._is_full = bool(self._pending_telemetry)
            self._add_telemetry(events, size)
        return after, events

    def _add_telemetry(self, batch: list[Event], size: int) -> None:
        """Add telemetry, as far as there is room."""
        for key, event in list(self._pending_telemetry.items()):
            size += size_of(event)
            if len(batch) >= MAX_EVENTS or (batch and size > self._limit):
                break
            batch.append(event)
            del self._pending_telemetry[key]

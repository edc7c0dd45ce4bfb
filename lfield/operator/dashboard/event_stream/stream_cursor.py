"""Position of a subscriber in a host's event stream: the requests after a link loss. Sans-IO."""

from __future__ import annotations

from msgspec.structs import replace

from lfield.wire.events import TelemetryEvent
from lfield.wire.subscription_messages import EventBatch, Subscribe

#: The incarnation of no host: a subscriber that names it receives all stored events.
_NO_INCARNATION = 1

#: The name of lost state events in counts.
STATE = "state"

#: Seconds before a host is dialled again: after a working link, the maximum, and the maximum when it was
#: silent. Together with the time-out of a silent link, it is followed again within 10 s after the path is
#: restored.
MIN_RETRY, MAX_RETRY, MAX_RETRY_UNREACHED = 0.25, 5.0, 2.0


class StreamCursor:
    """One host. `since`: request its states after that number; None: only new events."""

    def __init__(self, since: int | None = None, telemetry: float = 0.0) -> None:
        self._since, self._telemetry = since, telemetry
        self.incarnation = self.number = 0
        self._failures = 0
        self._missed = False

    def watch_request(self, incarnation: int) -> Subscribe:
        """The request to a host with that incarnation."""
        if self.incarnation:
            return Subscribe(self.incarnation, self.number, self._telemetry)
        if self._since is not None:
            return Subscribe(incarnation, self._since, self._telemetry)
        return Subscribe(_NO_INCARNATION if self._missed else 0, 0, self._telemetry)

    def accept(self, batch: EventBatch) -> EventBatch:
        """The batch without events received before; the missing numbers are the lost states.

        Of a new incarnation all reported losses count; events before the subscription are not lost for a
        subscriber that starts with new events.
        """
        self._failures = 0
        is_same_run = batch.incarnation == self.incarnation
        known = self.number if is_same_run else batch.after
        states = {e.number for e in batch.events if not isinstance(e.what, TelemetryEvent)}
        fresh = [e for e in batch.events if isinstance(e.what, TelemetryEvent) or e.number > known]
        last = max((event.number for event in batch.events), default=0)
        self.incarnation, self.number = batch.incarnation, max(known, batch.after, last)
        lost = dict(batch.lost)
        if is_same_run:
            lost.pop(STATE, None)
            if (missing := self.number - known - sum(number > known for number in states)) > 0:
                lost[STATE] = missing
        return replace(batch, events=fresh, lost=lost)

    def on_unreachable(self) -> None:
        """Record that the host is not running: one that answers later has started after this subscriber."""
        self._missed = True

    def next_retry(self, *, unreached: bool = False) -> float:
        """Seconds until the next attempt after a link failed or closed, or its host is `unreached`."""
        self._failures += 1
        return float(
            min(
                MAX_RETRY_UNREACHED if unreached else MAX_RETRY,
                MIN_RETRY * 2 ** (min(self._failures, 10) - 1),
            )
        )

"""Token-bucket rate limit for each kind of frequent events, with a count of dropped ones. Sans-IO.

A program may hop or call a portal a hundred thousand times a second; recording each of these events would
take longer than the event itself. Only frequent kinds have a budget. An exhausted budget is detected at
almost no cost: time is read only when budgets are refilled.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

from lfield.wire.events import EventsDropped


class RateLimit(NamedTuple):
    """Burst size, and events per second."""

    burst: float
    rate: float


#: Lines and pieces of text; a text that is longer than PIECE characters counts as several.
PRINTS, PIECE = RateLimit(8192.0, 2000.0), 128
#: Maximum rate of recorded hops with and without subscribers.
MIGRATIONS, MIGRATIONS_UNOBSERVED = RateLimit(4000.0, 2000.0), RateLimit(50.0, 200.0)
PORTALS = RateLimit(4000.0, 2000.0)
INSTRUCTIONS = RateLimit(400.0, 200.0)
#: Seconds between two refills; and between two reports of dropped events.
REFILL_EVERY, REPORT_EVERY = 0.25, 1.0


class EventRateLimiter:
    """The limit of one kind of events, with a full budget at first; `emit` reports drops. Times are in
    seconds.

    `unobserved` is the lower limit without subscribers, which applies at first.
    """

    def __init__(
        self,
        emit: Callable[[EventsDropped], object],
        observed: RateLimit,
        unobserved: RateLimit | None = None,
    ) -> None:
        self._emit, self._observed_limits, self._unobserved_limits = emit, observed, unobserved or observed
        self._allowed = self._unobserved_limits
        self._tokens = self._allowed.burst
        self._skipped: Counter[str] = Counter()
        self._filled = self._reported_at = 0.0

    def try_acquire(self, kind: str, cost: float = 1.0) -> bool:
        """Whether to record an event of that kind; otherwise it is counted as dropped.

        The count of dropped events is reported before the next recorded event, at its place in the order.
        """
        if self._tokens < 1.0:
            self._skipped[kind] += 1
            return False
        self._tokens -= cost
        if self._skipped:
            self._emit_dropped()
        return True

    def refill(self, now: float) -> None:
        """Refill the budget for the elapsed time."""
        burst, rate = self._allowed
        self._tokens = min(burst, self._tokens + max(0.0, now - self._filled) * rate)
        self._filled = now

    def restart(self) -> None:
        """Restore the full budget, and clear the count of dropped events."""
        self._tokens, self._filled, self._reported_at = self._allowed.burst, 0.0, 0.0
        self._skipped = Counter()

    def set_observed(self, *, on: bool) -> None:
        """Set whether there are subscribers."""
        allowed = self._observed_limits if on else self._unobserved_limits
        if allowed != self._allowed:
            self._allowed, self._tokens = allowed, allowed.burst

    def report_dropped(self, now: float, *, at_once: bool = False) -> None:
        """Report the number of dropped events if a report is due, or `at_once`."""
        if self._skipped and (at_once or now - self._reported_at >= REPORT_EVERY):
            self._reported_at = now
            self._emit_dropped()

    def _emit_dropped(self) -> None:
        skipped, self._skipped = self._skipped, Counter()
        for kind, count in skipped.items():
            self._emit(EventsDropped(kind, count))

"""The round-trip time of one link, measured with its heartbeats (RFC 6298). Pure."""

from __future__ import annotations

#: The weights of a new sample in the mean and in the variation, and how many variations the time-out adds to
#: the mean (RFC 6298, section 2).
ALPHA, BETA, VARIATIONS = 1 / 8, 1 / 4, 4.0
#: At most so many heartbeats without an answer are remembered.
MOST_OPEN = 16


class RoundTrip:
    """Mean and variation of a round-trip time, in seconds; None before the first sample."""

    def __init__(self) -> None:
        self.mean: float | None = None
        self.variation = 0.0
        #: The last sample.
        self.last: float | None = None

    def add(self, sample: float) -> None:
        """Count a sample, in seconds. A negative one is no sample: the clock was set back."""
        if sample < 0.0:
            return
        self.last = sample
        if self.mean is None:
            self.mean, self.variation = sample, sample / 2
            return
        self.variation += BETA * (abs(self.mean - sample) - self.variation)
        self.mean += ALPHA * (sample - self.mean)

    @property
    def bound(self) -> float | None:
        """The time within which an answer is expected, in seconds (RTO of RFC 6298 without its floor)."""
        return None if self.mean is None else self.mean + VARIATIONS * self.variation


class Heartbeats:
    """The heartbeats of one end of a link: their tokens, which of them are due, and what the answers measure.

    The two ends send in turns, so that both measure for the price of one; `first` is whose turn comes first.
    Times are of a monotonic clock, in seconds.
    """

    def __init__(self, now: float, *, first: bool) -> None:
        self.round_trip = RoundTrip()
        self._turn, self._sent_at, self._token = first, now, 0
        self._open: dict[int, float] = {}

    def is_due(self, now: float, silent: float, every: float) -> bool:
        """Whether to send one: after half an interval without a message where it is this end's turn, after
        one and a half where it is not, and after five intervals on a link that has other messages."""
        return silent >= (0.5 if self._turn else 1.5) * every or now - self._sent_at >= 5 * every

    def send(self, now: float) -> int:
        """One is sent now; returns its token."""
        self._token += 1
        self._turn, self._sent_at = False, now
        if len(self._open) >= MOST_OPEN:
            del self._open[next(iter(self._open))]
        self._open[self._token] = now
        return self._token

    def received(self) -> None:
        """One of the other end has come."""
        self._turn = True

    def answered(self, token: int, now: float) -> None:
        """An answer has come. One to no heartbeat, or a second one, counts for nothing."""
        sent = self._open.pop(token, None)
        if sent is not None:
            self.round_trip.add(now - sent)

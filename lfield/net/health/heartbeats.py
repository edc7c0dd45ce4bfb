"""The heartbeats of one end of a link: when one is due, what they measure, how long a silence may be. Pure.

On a bad path a message is late and not missing, since TCP repeats it: how late, the heartbeats show. A link
is given the time that four answers as late as the latest of the last minutes would take, within bounds. So
on a calm path a dead link is found as soon as with a fixed time-out, and a silence that is usual on a bad one
ends no link.
"""

from __future__ import annotations

#: Seconds between two looks at a link. One in use is never silent for more than one and a half of these and a
#: round trip, unless something is lost.
PING_EVERY = 1.0
#: Seconds of silence after which another connection is tried beside a link, and after which it is given up:
#: at the least; and at the most, since a coordinator that waits for the host has to learn it in time.
SUSPECT_AFTER, LOST_AFTER, LONGEST = 2.0, 3.0, 8.0
#: So many answers as late as the latest may be late one after the other.
LATE_IN_A_ROW = 4.0
#: At most so many heartbeats without an answer are remembered.
MOST_OPEN = 16
#: The weights of a new sample in the mean and in the variation, and how many variations the bound adds to the
#: mean (RFC 6298, section 2).
ALPHA, BETA, VARIATIONS = 1 / 8, 1 / 4, 4.0
#: What is assumed before the first sample, in seconds (RFC 6298, section 2.1).
FIRST = 1.0
#: The latest answer counts for half after so many seconds.
HALF_LIFE = 600.0


class Smoothed:
    """Mean and variation of a round-trip time, in seconds (RFC 6298, section 2).

    The mean is None before the first sample, whose share `first` is taken for the variation.
    """

    def __init__(self, mean: float | None = None, first: float = 1 / 2) -> None:
        self._first = first
        self.mean, self.variation = mean, (mean or 0.0) * first

    def count(self, sample: float) -> None:
        """Count a sample, in seconds."""
        if self.mean is None:
            self.mean, self.variation = sample, sample * self._first
            return
        self.variation += BETA * (abs(self.mean - sample) - self.variation)
        self.mean += ALPHA * (sample - self.mean)


class RoundTrip(Smoothed):
    """The round-trip time of a link.

    TCP repeats what is lost: on a bad path some samples are many times the mean, so the longest of the last
    minutes is known as well.
    """

    def __init__(self) -> None:
        super().__init__()
        #: The last sample.
        self.last: float | None = None
        self._longest, self._at = 0.0, 0.0

    def add(self, sample: float, now: float) -> None:
        """Count a sample of this moment; both in seconds. A negative one is none: the clock was set back."""
        if sample < 0.0:
            return
        self.last = sample
        if self.mean is None or sample >= self.longest(now):
            self._longest, self._at = sample, now
        self.count(sample)

    @property
    def bound(self) -> float | None:
        """The time within which an answer is expected, in seconds (RTO of RFC 6298 without its floor)."""
        return None if self.mean is None else self.mean + VARIATIONS * self.variation

    def longest(self, now: float) -> float:
        """The longest sample, which counts for half after HALF_LIFE; not less than `bound`.

        Before the first sample it is FIRST.
        """
        if self.bound is None:
            return FIRST
        kept: float = self._longest * 2.0 ** ((self._at - now) / HALF_LIFE)
        return max(kept, self.bound)


class Heartbeats:
    """Those of this end for one host, over all links with it. Times are of a monotonic clock, in seconds.

    The two ends send in turns, so that both measure for the price of one; `first` is whose turn comes first.
    """

    def __init__(self, *, first: bool) -> None:
        self.round_trip = RoundTrip()
        self._first = self._turn = first
        self._sent_at, self._token = 0.0, 0
        self._open: dict[int, float] = {}

    def begin(self, now: float) -> None:
        """A link is made: what was sent over an earlier one is not answered on it."""
        self._turn, self._sent_at = self._first, now
        self._open.clear()

    def is_due(self, now: float, silent: float) -> bool:
        """Whether to send one: after half an interval without a message where it is this end's turn, after
        one and a half where it is not, and after five intervals on a link that has other messages."""
        waits = (0.5 if self._turn else 1.5) * PING_EVERY
        return silent >= waits or now - self._sent_at >= 5 * PING_EVERY

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
            self.round_trip.add(now - sent, now)

    def suspect_after(self, now: float) -> float:
        """The silence after which another connection is tried beside the link."""
        return min(LONGEST, max(SUSPECT_AFTER, 1.5 * PING_EVERY + self.round_trip.longest(now)))

    def lost_after(self, now: float) -> float:
        """The silence after which the link is given up."""
        return min(LONGEST, max(LOST_AFTER, 1.5 * PING_EVERY + LATE_IN_A_ROW * self.round_trip.longest(now)))

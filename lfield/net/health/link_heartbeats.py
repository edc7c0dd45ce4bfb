"""Adaptive link heartbeats: the times when they are due, the round-trip time, and the silence that ends a
link. Sans-IO.

On a lossy path a message is only late, since TCP repeats it. The time-out is four times the latest answer of
the last minutes, within bounds. On a good path a dead link is thus detected as soon as with a fixed time-out,
and silence that is usual on a bad path ends no link.

A link that carries only background reports is idle. Its heartbeats are rare, because many idle links would
fill a slow radio, and its silence is detected within 10 s.
"""

from __future__ import annotations

#: Seconds between two checks of a link. A link in use is silent for at most 1.5 of these intervals plus a
#: round trip, unless a packet is lost.
PING_EVERY = 1.0
#: Seconds of silence after which another connection is tried in parallel, and after which the link is closed:
#: the minimum; and the maximum, since a coordinator that waits for the host has to learn of it in time.
SUSPECT_AFTER, LOST_AFTER, MAX_SILENCE = 2.0, 3.0, 8.0
#: Seconds between two heartbeats of an idle link on a good path, and of silence after which it is closed. On
#: a path whose answers may come late, heartbeats are more frequent.
IDLE_PING_EVERY, IDLE_LOST_AFTER = 6.5, 9.0
#: The number of consecutive answers, as late as the latest, that a time-out allows; and the number for idle
#: links, which have one heartbeat for each time-out.
LATE_FACTOR, IDLE_LATE_FACTOR = 4.0, 2.0
#: Maximum number of unanswered heartbeats that are remembered.
MAX_PENDING = 16
#: Gains of a new sample in mean and variation, and the number of variations added to the mean (RFC 6298,
#: section 2).
ALPHA, BETA, DEVIATIONS = 1 / 8, 1 / 4, 4.0
#: Initial value in seconds, before the first sample (RFC 6298, section 2.1).
INITIAL_RTT = 1.0
#: Half-life of the latest answer, in seconds.
HALF_LIFE = 600.0


class SmoothedRtt:
    """Mean and variation of a round-trip time, in seconds (RFC 6298, section 2).

    The mean is None before the first sample, of which the share `first` is the initial variation.
    """

    def __init__(self, mean: float | None = None, first: float = 1 / 2) -> None:
        self._first = first
        self.mean, self.variation = mean, (mean or 0.0) * first

    def update(self, sample: float) -> None:
        """Add a sample, in seconds."""
        if self.mean is None:
            self.mean, self.variation = sample, sample * self._first
            return
        self.variation += BETA * (abs(self.mean - sample) - self.variation)
        self.mean += ALPHA * (sample - self.mean)


class RoundTrip(SmoothedRtt):
    """The round-trip time of a link.

    TCP retransmission makes some samples many times the mean on a bad path, so the longest sample of the last
    minutes is recorded as well.
    """

    def __init__(self) -> None:
        super().__init__()
        #: The last sample.
        self.last: float | None = None
        self._longest, self._at = 0.0, 0.0

    def add(self, sample: float, now: float) -> None:
        """Add a sample, in seconds. Negative samples are ignored: the clock was set back."""
        if sample < 0.0:
            return
        self.last = sample
        if self.mean is None or sample >= self.longest(now):
            self._longest, self._at = sample, now
        self.update(sample)

    @property
    def bound(self) -> float | None:
        """The expected limit of an answer's delay, in seconds (RTO of RFC 6298 without its minimum)."""
        return None if self.mean is None else self.mean + DEVIATIONS * self.variation

    def longest(self, now: float) -> float:
        """The longest sample, decaying with HALF_LIFE, and at least `bound`; INITIAL_RTT without a sample."""
        if self.bound is None:
            return INITIAL_RTT
        decayed: float = self._longest * 2.0 ** ((self._at - now) / HALF_LIFE)
        return max(decayed, self.bound)


class Heartbeats:
    """The heartbeats of one end for one host, over all links with it. Times are monotonic seconds.

    The ends alternate, so that both ends measure with the heartbeats of one; `first` says whether this end
    starts. Heartbeats of an idle link are at most `idle_interval` seconds apart, and the `first` end sends
    all of them: TCP then delays the acknowledgement at the other end and sends it with the answer.
    """

    def __init__(self, *, first: bool, idle_interval: float = IDLE_PING_EVERY) -> None:
        self._idle_interval = idle_interval
        self.round_trip = RoundTrip()
        self._first = self._turn = first
        self._sent_at, self._token = 0.0, 0
        self._open: dict[int, float] = {}

    def on_link_made(self, now: float) -> None:
        """A link was made: heartbeats sent on an earlier link get no answer."""
        self._turn, self._sent_at = self._first, now
        self._open.clear()

    def interval(self, now: float, *, is_idle: bool) -> float:
        """Seconds between two heartbeats."""
        if not is_idle:
            return PING_EVERY
        late = IDLE_LATE_FACTOR * self.round_trip.longest(now)
        return min(self._idle_interval, max(PING_EVERY, IDLE_LOST_AFTER - PING_EVERY - late))

    def is_due(self, now: float, silent: float, *, is_idle: bool = False) -> bool:
        """Whether to send a heartbeat: without traffic, half a second before the end of an interval if it is
        the turn of this end, otherwise half a second after; with other traffic, after five intervals.
        """
        interval = self.interval(now, is_idle=is_idle)
        is_turn = self._first if is_idle else self._turn
        wait = interval + (-0.5 if is_turn else 0.5) * PING_EVERY
        return silent >= wait or now - self._sent_at >= 5 * interval

    def send(self, now: float) -> int:
        """Record a sent heartbeat. Returns its token."""
        self._token += 1
        self._turn, self._sent_at = False, now
        if len(self._open) >= MAX_PENDING:
            del self._open[next(iter(self._open))]
        self._open[self._token] = now
        return self._token

    def on_ping(self) -> None:
        """A heartbeat of the other end has arrived."""
        self._turn = True

    def on_pong(self, token: int, now: float) -> None:
        """An answer has arrived. Unknown and repeated answers are ignored."""
        sent = self._open.pop(token, None)
        if sent is not None:
            self.round_trip.add(now - sent, now)

    def suspect_after(self, now: float, *, is_idle: bool = False) -> float:
        """The silence after which another connection is tried in parallel."""
        late = self.interval(now, is_idle=is_idle) + 0.5 * PING_EVERY + self.round_trip.longest(now)
        return min(MAX_SILENCE, max(SUSPECT_AFTER, late))

    def lost_after(self, now: float, *, is_idle: bool = False) -> float:
        """The silence after which the link is closed."""
        if is_idle and self._idle_interval > PING_EVERY:
            return IDLE_LOST_AFTER
        return min(
            MAX_SILENCE, max(LOST_AFTER, 1.5 * PING_EVERY + LATE_FACTOR * self.round_trip.longest(now))
        )

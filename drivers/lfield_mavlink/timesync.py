"""The vehicle's clock beside ours, by round trips of TIMESYNC (https://mavlink.io/en/services/timesync.html)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from lfield.clock import Clock
from lfield_mavlink.dialect import dialect

#: Round trips that are kept; the shortest tells the offset best, since the least of it was waiting in queues.
KEPT = 10
#: Seconds after which the answer to a question is no longer believed.
LATE = 3.0


class Offset(NamedTuple):
    """`offset`: the vehicle's clock minus our wall clock; `round_trip`; both in seconds."""

    offset: float
    round_trip: float


class TimeSync:
    """Round trips with one vehicle, and answers to its own."""

    def __init__(self, clock: Clock, send: Callable[[Any], None]) -> None:
        self._clock, self._send = clock, send
        self._asked: deque[int] = deque(maxlen=4)
        self._kept: deque[Offset] = deque(maxlen=KEPT)

    def ask(self) -> None:
        """Begin a round trip."""
        now = self._now()
        self._asked.append(now)
        self._send(dialect.MAVLink_timesync_message(0, now))

    def on_message(self, message: Any) -> Offset | None:
        """Take a TIMESYNC in: a question is answered; an answer to ours gives what is now known."""
        now = self._now()
        if message.tc1 == 0:
            self._send(dialect.MAVLink_timesync_message(now, message.ts1))
            return None
        # The vehicle answers other ground stations too, and a packet may come twice.
        if message.ts1 not in self._asked:
            return None
        self._asked.remove(message.ts1)
        round_trip = (now - message.ts1) / 1e9
        if round_trip > LATE:
            return None
        wall = self._clock.time() - now / 1e9
        self._kept.append(Offset((message.tc1 - (message.ts1 + now) / 2) / 1e9 - wall, round_trip))
        return min(self._kept, key=lambda kept: kept.round_trip)._replace(round_trip=round_trip)

    def _now(self) -> int:
        """Our monotonic clock in nanoseconds, never 0, which marks a question."""
        return max(round(self._clock.monotonic() * 1e9), 1)

"""Window of a numbered stream: the number of bytes that may be in transit, and the time when the peer is
asked for them.

The fabric queues the data that a slow path cannot carry, and an emergency stop waits behind this data. So the
window follows the delay: it grows while it is used and answers are about as fast as the fastest one, and
shrinks when answers are later.
"""

from __future__ import annotations

from lfield.net.health.link_heartbeats import DEVIATIONS, SmoothedRtt

#: Largest data of one packet in bytes.
MAX_SEGMENT = 8 << 10
#: The bytes in transit: initial, minimum, maximum.
INITIAL_WINDOW, MIN_WINDOW, MAX_WINDOW = 16 << 10, 4 << 10, 256 << 10
#: Seconds by which an answer may exceed the fastest one before the window shrinks.
MAX_QUEUEING = 0.2
#: Time-out of the first packet, the shortest, and the longest one, in seconds; on a slow path the longest is
#: `SLOW_PATH` round trips.
INITIAL_TIMEOUT, MIN_TIMEOUT, MAX_TIMEOUT, SLOW_PATH = 0.5, 0.2, 1.0, 4.0


class SendWindow:
    """The window of one direction. Sans-IO."""

    def __init__(self) -> None:
        self.size = INITIAL_WINDOW
        self._rtt = SmoothedRtt()
        #: The fastest answer in seconds; 0 before the first one.
        self._fastest = 0.0
        self._backoff = 1

    @property
    def round_trip(self) -> tuple[float, float]:
        """The smoothed round trip and its variation, in seconds; 0 before the first answer."""
        return self._rtt.mean or 0.0, self._rtt.variation

    @property
    def timeout(self) -> float:
        """The seconds until the peer is asked for the packets that have arrived (as in RFC 6298 for a
        repetition).
        """
        mean = self._rtt.mean
        if mean is None:
            return min(INITIAL_TIMEOUT * self._backoff, MAX_TIMEOUT)
        usual = max(MIN_TIMEOUT, mean + DEVIATIONS * self._rtt.variation)
        longest = max(MAX_TIMEOUT, SLOW_PATH * mean)
        return min(usual * self._backoff, longest)

    def on_answer(self, seconds: float, acknowledged: int, in_flight: int) -> None:
        """A packet that was sent once was acknowledged: its round trip, the acknowledged bytes, and the bytes
        that were in transit.
        """
        self._rtt.update(seconds)
        self._fastest = min(self._fastest or seconds, seconds)
        self._backoff = 1
        if seconds > self._fastest + MAX_QUEUEING:
            self.size = max(MIN_WINDOW, self.size - acknowledged)
        elif 2 * in_flight >= self.size:
            self.size = min(MAX_WINDOW, self.size + acknowledged)

    def on_silence(self) -> None:
        """No acknowledgement arrived in time."""
        self._backoff = min(2 * self._backoff, 64)

    def on_loss(self) -> None:
        """A packet was lost."""
        self._backoff = 1
        self.size = max(MIN_WINDOW, self.size // 2)

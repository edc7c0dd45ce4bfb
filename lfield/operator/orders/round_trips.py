"""When a datagram to a host is repeated: by the round trip that was measured, and before that with care.

A repeat that was not needed costs some 300 bytes, and one that comes late delays a stop. So the time-out is
shorter than that of RFC 6298, which is for whole windows of data.
"""

from __future__ import annotations

from collections.abc import Mapping

#: Before any round trip is measured, the shortest interval in seconds, and the rate in bytes/s that all hosts
#: together are sent: half of a radio of 57.6 kbit/s, whose other half is for the answers.
FIRST, RATE = 0.1, 3600.0
#: The shortest and the longest interval, in seconds. So many are alike, since radio loses at random; by this
#: factor each further one is longer.
SHORTEST, LONGEST, ALIKE, BACKOFF = 0.04, 1.0, 4, 1.5
#: How much the round trip may vary is not known after one measurement: this part of it.
FIRST_VARIATION = 0.25
#: A variation of the round trip of less than so many seconds is taken for so many.
LEAST_VARIATION = 0.01
#: An answer is missed after the round trip and so many variations of it.
VARIATIONS = 2.0
#: What is received but not confirmed is asked for after one interval, then two, up to so many.
EXECUTING = 4


class RoundTrip:
    """The round trip to one host, smoothed as in RFC 6298; in seconds."""

    def __init__(self, measured: float | None = None) -> None:
        self.smoothed = measured
        self._variation = (measured or 0.0) * FIRST_VARIATION

    def add(self, sample: float) -> None:
        """A datagram was answered after so many seconds."""
        if self.smoothed is None:
            self.smoothed, self._variation = sample, sample * FIRST_VARIATION
            return
        self._variation = 0.75 * self._variation + 0.25 * abs(self.smoothed - sample)
        self.smoothed = 0.875 * self.smoothed + 0.125 * sample

    @property
    def time_out(self) -> float | None:
        """After so many seconds an answer is missed; None while nothing is measured."""
        if self.smoothed is None:
            return None
        late = self.smoothed + max(VARIATIONS * self._variation, LEAST_VARIATION)
        return min(max(late, SHORTEST), LONGEST)


def interval(trip: RoundTrip, others: Mapping[str, RoundTrip], repeats: int, size: int) -> float:
    """Seconds until a datagram is repeated that was sent `repeats` times before.

    Without a measurement of its own, a host is waited for as the slowest of the others. Where none is
    measured, `size` bytes of all datagrams of a round bound the rate.
    """
    measured = trip.time_out
    if measured is None:
        known = [late for other in others.values() if (late := other.time_out) is not None]
        measured = max(known) if known else max(FIRST, size / RATE)
    return min(measured * BACKOFF ** max(0, repeats - ALIKE), max(LONGEST, measured))

"""The rate of a path, measured by the sender of small batches, and the pause that keeps to a share. Sans-IO.

On a slow channel, a batch is acknowledged later than a small one. The median of several such measurements
ignores batches that were lost and repeated.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median

#: Measurements that are kept, and the additional bytes of a batch that gives one.
SAMPLES, MIN_EXTRA = 9, 48
#: Above this rate in bytes/s a path is not slow, and there is no limit.
FAST_RATE = 100_000.0
#: The share of the rate that events and telemetry of one subscription may use; and the bytes of a batch and
#: its acknowledgement in addition to the content: headers of IP, TCP and TLS, and TCP's own acknowledgements.
SHARE, OVERHEAD = 0.08, 280
#: The longest pause in seconds, and the smallest limit of a batch in bytes.
MAX_PAUSE, MIN_BATCH = 5.0, 1 << 10


class PathRate:
    """Measures one path. Sizes are bytes, times are seconds."""

    def __init__(self) -> None:
        #: The smallest batch, and the quickest acknowledgement.
        self._smallest = self._quickest = math.inf
        self._seconds_per_byte: deque[float] = deque(maxlen=SAMPLES)

    def add(self, size: int, took: float) -> None:
        """Add a batch of this size that was acknowledged after `took` seconds."""
        self._smallest, self._quickest = min(size, self._smallest), min(took, self._quickest)
        if size >= self._smallest + MIN_EXTRA:
            self._seconds_per_byte.append(max(0.0, took - self._quickest) / (size - self._smallest))

    @property
    def rate(self) -> float | None:
        """The rate of the path in bytes/s; None if it is not known to be slow."""
        if not self._seconds_per_byte:
            return None
        each = median(self._seconds_per_byte)
        return 1.0 / each if each * FAST_RATE > 1.0 else None

    def batch_limit(self, maximum: int) -> int:
        """The largest batch, of at most `maximum` bytes, after which the longest pause is sufficient."""
        rate = self.rate
        return maximum if rate is None else min(maximum, max(MIN_BATCH, int(SHARE * rate * MAX_PAUSE)))

    def pause(self, size: int) -> float:
        """The pause after a batch of this size that keeps to the share."""
        rate = self.rate
        return 0.0 if rate is None else min(MAX_PAUSE, (size + OVERHEAD) / (SHARE * rate))

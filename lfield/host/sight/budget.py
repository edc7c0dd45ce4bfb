"""How many events of one sort are told: each, up to so many a second; of the rest how many there were. Pure.

A program may hop or call a portal a hundred thousand times a second. Nobody could read that, and to tell it
would take longer than to do it. What can be told that often has a budget; nothing else needs one.
"""

from __future__ import annotations

from collections import Counter

from lfield.wire.events import Skipped

#: Of each sort so many are told in a second, and so many at once after a quiet time.
RATE, BURST = 200.0, 400.0
#: Seconds between two words about how many were skipped.
SETTLED_EVERY = 1.0


class Budget:
    """One for each sort of events; times are in seconds."""

    def __init__(self, rate: float = RATE, burst: float = BURST) -> None:
        self._rate, self._burst = rate, burst
        self._left, self._at = burst, 0.0
        self._skipped: Counter[str] = Counter()
        self._settled = 0.0

    def take(self, kind: str, now: float) -> bool:
        """Whether an event of that kind is told now; else it is counted."""
        if now > self._at:
            self._left = min(self._burst, self._left + (now - self._at) * self._rate)
            self._at = now
        if self._left >= 1.0:
            self._left -= 1.0
            return True
        self._skipped[kind] += 1
        return False

    def settle(self, now: float) -> list[Skipped]:
        """How many were skipped, by kind, if it is time to say so."""
        if not self._skipped or now - self._settled < SETTLED_EVERY:
            return []
        skipped, self._skipped, self._settled = self._skipped, Counter(), now
        return [Skipped(kind, count) for kind, count in skipped.items()]

"""How many events of one sort are told: each, up to so many a second; of the rest how many there were. Pure.

A program may hop or call a portal a hundred thousand times a second. Nobody could read that, and to tell it
would take longer than to do it. What can happen that often has a budget; nothing else needs one. To find that
one is spent costs next to nothing: time is looked at when it is filled up.
"""

from __future__ import annotations

from collections import Counter

from lfield.wire.events import Skipped

#: Of each sort so many are told in a second, and so many at once.
RATE, BURST = 200.0, 400.0
#: Of hops fewer at once: what hops that often is in a hurry.
BURST_OF_HOPS = 50.0
#: Seconds between two times that budgets are filled up; and between two words about what was skipped.
FILLED_EVERY, SETTLED_EVERY = 0.25, 1.0


class Budget:
    """One for each sort of events, full at first. Times are in seconds."""

    def __init__(self, burst: float = BURST, rate: float = RATE) -> None:
        self._rate, self._burst, self._left = rate, burst, burst
        self._skipped: Counter[str] = Counter()
        self._filled = self._settled = 0.0

    def take(self, kind: str) -> bool:
        """Whether an event of that kind is told now; else it is counted."""
        if self._left < 1.0:
            self._skipped[kind] += 1
            return False
        self._left -= 1.0
        return True

    def fill(self, now: float) -> None:
        """Time has passed."""
        self._left = min(self._burst, self._left + max(0.0, now - self._filled) * self._rate)
        self._filled = now

    def settle(self, now: float) -> list[Skipped]:
        """How many were skipped, by kind, if it is time to say so."""
        if not self._skipped or now - self._settled < SETTLED_EVERY:
            return []
        skipped, self._skipped, self._settled = self._skipped, Counter(), now
        return [Skipped(kind, count) for kind, count in skipped.items()]

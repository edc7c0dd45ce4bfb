"""How many events of one sort are told: each, up to so many a second; of the rest how many there were. Pure.

A program may hop or call a portal a hundred thousand times a second. Nobody could read that, and to tell it
would take longer than to do it. What can happen that often has a budget; nothing else needs one. To find that
one is spent costs next to nothing: time is looked at when it is filled up.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

from lfield.wire.events import Skipped


class Allowance(NamedTuple):
    """So many are told at once, and so many a second."""

    burst: float
    rate: float


#: Lines and pieces of text; one that is longer than PIECE characters counts as several.
PRINTS, PIECE = Allowance(8192.0, 2000.0), 128
#: Hops while somebody watches, and else: what hops that often is in a hurry, and a host keeps it for nobody.
HOPS, HOPS_UNWATCHED = Allowance(4000.0, 2000.0), Allowance(50.0, 200.0)
PORTALS = Allowance(4000.0, 2000.0)
INSTRUCTIONS = Allowance(400.0, 200.0)
#: Seconds between two times that budgets are filled up; and between two words about what was skipped.
FILLED_EVERY, SETTLED_EVERY = 0.25, 1.0


class Budget:
    """One for each sort of events, full at first; what was skipped it tells by `tell`. Times are in seconds.

    Where fewer are told while nobody watches, `unwatched` says how many; so it begins then.
    """

    def __init__(
        self,
        tell: Callable[[Skipped], object],
        watched: Allowance,
        unwatched: Allowance | None = None,
    ) -> None:
        self._tell, self._watched, self._unwatched = tell, watched, unwatched or watched
        self._allowed = self._unwatched
        self._left = self._allowed.burst
        self._skipped: Counter[str] = Counter()
        self._filled = self._settled = 0.0

    def take(self, kind: str, cost: float = 1.0) -> bool:
        """Whether an event of that kind is told now; else it is counted.

        Where one is told again it is first said how many were not: that is its place.
        """
        if self._left < 1.0:
            self._skipped[kind] += 1
            return False
        self._left -= cost
        if self._skipped:
            self._say()
        return True

    def fill(self, now: float) -> None:
        """Time has passed."""
        burst, rate = self._allowed
        self._left = min(burst, self._left + max(0.0, now - self._filled) * rate)
        self._filled = now

    def watch(self, *, on: bool) -> None:
        """Somebody watches now, or nobody does any more."""
        allowed = self._watched if on else self._unwatched
        if allowed != self._allowed:
            self._allowed, self._left = allowed, allowed.burst

    def settle(self, now: float, *, at_once: bool = False) -> None:
        """Say how many were skipped, if it is time to, or `at_once`."""
        if self._skipped and (at_once or now - self._settled >= SETTLED_EVERY):
            self._settled = now
            self._say()

    def _say(self) -> None:
        skipped, self._skipped = self._skipped, Counter()
        for kind, count in skipped.items():
            self._tell(Skipped(kind, count))

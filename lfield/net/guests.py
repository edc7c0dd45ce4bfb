"""How many may be let in of whom nothing is known yet, and who must go for the next: a pure rule."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterator
from typing import Generic, TypeVar

G = TypeVar("G")


class Guests(Generic[G]):
    """At most `most` at a time. One more pushes one out, drawn by `dice` among those of the fullest address.

    Whoever calls from elsewhere is so never kept out by a flood from one address. At the same address it is
    for the dice: whoever calls again gets in some time, where the oldest or the newest could be pushed out
    for as long as the flood goes on.
    """

    def __init__(self, most: int, dice: random.Random) -> None:
        self._most, self._dice = most, dice
        self._addresses: dict[G, str] = {}

    def enter(self, guest: G, address: str, *, last: bool = False) -> G | None:
        """Let one in; who must go for it, or None. For the `last` that there is room for, one must go too."""
        full = last or len(self._addresses) >= self._most
        pushed = self._draw() if full and self._addresses else None
        if pushed is not None:
            del self._addresses[pushed]
        self._addresses[guest] = address
        return pushed

    def __iter__(self) -> Iterator[G]:
        return iter(list(self._addresses))

    def leave(self, guest: G) -> None:
        """One has gone, or is a guest no longer; any other is none here."""
        self._addresses.pop(guest, None)

    def _draw(self) -> G:
        counts = Counter(self._addresses.values())
        fullest = max(counts.values())
        return self._dice.choice([g for g, address in self._addresses.items() if counts[address] == fullest])

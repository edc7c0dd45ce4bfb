"""How many may be let in of whom nothing is known yet, and who must go for the next: a pure rule."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

from lfield.net.waiting.handshakes import Sources

G = TypeVar("G")


def nothing_known(guest: object) -> int:
    """All guests are alike."""
    return 0


class Guests(Generic[G]):
    """At most `most` at a time. One more pushes one out, drawn by `dice` among those of the fullest address.

    Those of one address that are at another `stage` of their handshake count as of another address. Of
    addresses with as many guests one is chosen that is less trusted.

    Whoever calls from elsewhere is so never kept out by a flood from one address. At the same address it is
    for the dice: whoever calls again gets in some time, where the oldest or the newest could be pushed out
    for as long as the flood goes on.
    """

    def __init__(
        self,
        most: int,
        dice: random.Random,
        stage: Callable[[G], int] = nothing_known,
    ) -> None:
        self._most, self._dice, self._stage = most, dice, stage
        self._sources = Sources()
        self._addresses: dict[G, str] = {}

    def enter(self, guest: G, address: str, *, last: bool = False) -> G | None:
        """Let one in; who must go for it, or None. For the `last` that there is room for, one must go too."""
        full = last or len(self._addresses) >= self._most
        pushed = self._draw() if full and self._addresses else None
        if pushed is not None:
            self.leave(pushed)
        self._addresses[guest] = address
        return pushed

    def __iter__(self) -> Iterator[G]:
        return iter(list(self._addresses))

    def leave(self, guest: G) -> None:
        """One has gone; any other is none here."""
        address = self._addresses.pop(guest, None)
        if address is not None:
            self._sources.on_failed(address)

    def prove(self, guest: G, address: str) -> None:
        """Somebody, who may be no guest, has proven who it is, and is a guest no longer."""
        self._addresses.pop(guest, None)
        self._sources.on_proven(address)

    def _draw(self) -> G:
        groups = {guest: (address, self._stage(guest)) for guest, address in self._addresses.items()}
        counts = Counter(groups.values())
        worst = max((count, self._sources.trust(address)) for (address, _), count in counts.items())
        found = [g for g, group in groups.items() if (counts[group], self._sources.trust(group[0])) == worst]
        return self._dice.choice(found)

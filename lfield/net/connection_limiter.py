"""Bounded set of unauthenticated connections, with random eviction per source address. Sans-IO."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

from lfield.net.scheduling.handshake_scheduler import CallerAddresses

G = TypeVar("G")


def same_stage(connection: object) -> int:
    """Treats all guests as if they were at the same handshake stage."""
    return 0


class ConnectionLimiter(Generic[G]):
    """At most `limit` unauthenticated connections. When full, it evicts a random connection of the address
    with the most.

    Connections of one address at different handshake stages count as connections of different addresses.
    Among addresses with equally many, a less trusted one is chosen. A flood from one address therefore cannot
    lock out others. At the flooding address the choice is random (`rng`), so a legitimate caller eventually
    succeeds; a rule that always evicts the oldest or the newest could lock out this caller.
    """

    def __init__(
        self,
        limit: int,
        rng: random.Random,
        stage: Callable[[G], int] = same_stage,
    ) -> None:
        self._limit, self._rng, self._stage = limit, rng, stage
        self._sources = CallerAddresses()
        self._addresses: dict[G, str] = {}

    def admit(self, connection: G, address: str, *, last: bool = False) -> G | None:
        """Admit a connection; `last`: evict a connection even below the limit. Returns the evicted one, or
        None.
        """
        is_full = last or len(self._addresses) >= self._limit
        evicted = self._pick_evicted() if is_full and self._addresses else None
        if evicted is not None:
            self.release(evicted)
        self._addresses[connection] = address
        return evicted

    def __iter__(self) -> Iterator[G]:
        return iter(list(self._addresses))

    def release(self, connection: G) -> None:
        """Remove a closed connection; unknown connections are ignored."""
        address = self._addresses.pop(connection, None)
        if address is not None:
            self._sources.on_failed(address)

    def on_authenticated(self, connection: G, address: str) -> None:
        """A connection has authenticated, and no longer counts."""
        self._addresses.pop(connection, None)
        self._sources.on_proven(address)

    def _pick_evicted(self) -> G:
        groups = {client: (address, self._stage(client)) for client, address in self._addresses.items()}
        counts = Counter(groups.values())
        worst_group = max((count, self._sources.trust(address)) for (address, _), count in counts.items())
        candidates = [
            client
            for client, group in groups.items()
            if (counts[group], self._sources.trust(group[0])) == worst_group
        ]
        return self._rng.choice(candidates)

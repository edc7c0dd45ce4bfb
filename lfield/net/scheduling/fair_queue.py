"""Two-level round-robin queue: over identities, then over the connections of one identity. Sans-IO."""

from __future__ import annotations

from collections import OrderedDict
from enum import IntEnum
from typing import Generic, TypeVar

G = TypeVar("G")


class QueueRank(IntEnum):
    """Priority of an identity."""

    #: The identity is served in round-robin order.
    FIRST = 0
    #: The identity is served only while no identity of the first rank waits.
    BEHIND = 1
    #: The identity is served only after a change of its rank.
    HELD = 2


class FairQueue(Generic[G]):
    """Round robin over identities, and over the connections of each.

    An identity with sixty connections gets the same share as an identity with one. A round has at most
    `round_limit` turns, and ends when they have used `longest` seconds. `next` returns None when no eligible
    connection waits, or the round is over.
    """

    def __init__(self, round_limit: int, longest: float) -> None:
        self._round_limit = self._remaining = round_limit
        #: Seconds used in this round.
        self._longest, self.charged = longest, 0.0
        #: Waiting connections by rank, in the order of their turns.
        self._queues: tuple[OrderedDict[str, OrderedDict[G, None]], ...] = tuple(
            OrderedDict() for _ in QueueRank
        )
        self._persons: dict[G, str] = {}
        #: Identities of another rank than the first.
        self.ranks: dict[str, QueueRank] = {}

    def add(self, connection: G, identity: str) -> None:
        """Add a connection with pending input at the end; the connection must not be waiting."""
        self._persons[connection] = identity
        self._queue_of(identity).setdefault(identity, OrderedDict())[connection] = None

    def next(self) -> G | None:
        """The next connection, which is then moved to the end."""
        if not self._remaining or self.charged >= self._longest:
            return None
        queue = next(filter(None, self._queues[: QueueRank.HELD]), None)
        if queue is None:
            return None
        self._remaining -= 1
        person = next(iter(queue))
        clients = queue[person]
        client = next(iter(clients))
        queue.move_to_end(person)
        clients.move_to_end(client)
        return client

    def set_rank(self, person: str, rank: QueueRank) -> None:
        """Move an identity, waiting or not, to the end of another rank."""
        if self.ranks.get(person, QueueRank.FIRST) is rank:
            return
        clients = self._queue_of(person).pop(person, None)
        if rank is QueueRank.FIRST:
            del self.ranks[person]
        else:
            self.ranks[person] = rank
        if clients is not None:
            self._queue_of(person)[person] = clients

    def charge(self, seconds: float) -> None:
        """Charge the last turn with its duration."""
        self.charged += seconds

    def remove(self, connection: G) -> None:
        """Remove a connection without pending input; ignored if it does not wait."""
        person = self._persons.pop(connection, None)
        if person is None:
            return
        queue = self._queue_of(person)
        del queue[person][connection]
        if not queue[person]:
            del queue[person]

    def start_round(self) -> None:
        """Start the next round."""
        self._remaining, self.charged = self._round_limit, 0.0

    @property
    def is_used(self) -> bool:
        """Whether a turn of this round was used."""
        return self._remaining < self._round_limit

    @property
    def is_full(self) -> bool:
        """Whether this round is over."""
        return not self._remaining or self.charged >= self._longest

    def _queue_of(self, person: str) -> OrderedDict[str, OrderedDict[G, None]]:
        return self._queues[self.ranks.get(person, QueueRank.FIRST)]

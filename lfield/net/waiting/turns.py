"""Whose message is next of all that wait at a host, and when none is for a while: a pure rule."""

from __future__ import annotations

from collections import OrderedDict
from enum import IntEnum
from typing import Generic, TypeVar

G = TypeVar("G")


class Rank(IntEnum):
    """Which persons have their turns before others."""

    #: In their turns.
    FIRST = 0
    #: When nobody of the first rank waits.
    BEHIND = 1
    #: Not at all, until they get another rank.
    HELD = 2


class Turns(Generic[G]):
    """Persons take turns, and the guests of a person among themselves.

    A person with sixty links so has no more than one with a single link, and whoever comes waits for one turn
    of each other person of the same rank. In a round at most `most` turns are taken, and none more when those
    have taken `longest` seconds. When `next` names nobody, either nobody waits whose rank lets them, or all
    wait for `again`.
    """

    def __init__(self, most: int, longest: float) -> None:
        self._most = self._left = most
        self._longest, self._taken = longest, 0.0
        #: Whoever waits, by rank, both in the order of their turns.
        self._queues: tuple[OrderedDict[str, OrderedDict[G, None]], ...] = tuple(OrderedDict() for _ in Rank)
        self._persons: dict[G, str] = {}
        self._ranks: dict[str, Rank] = {}

    def enter(self, guest: G, person: str) -> None:
        """A guest that does not wait yet has something to say from now on, and is last."""
        self._persons[guest] = person
        self._queue_of(person).setdefault(person, OrderedDict())[guest] = None

    def next(self) -> G | None:
        """Whose turn it is, now and no later: then it waits for the next one, behind all others."""
        if not self._left or self._taken >= self._longest:
            return None
        queue = next(filter(None, self._queues[: Rank.HELD]), None)
        if queue is None:
            return None
        self._left -= 1
        person = next(iter(queue))
        guests = queue[person]
        guest = next(iter(guests))
        queue.move_to_end(person)
        guests.move_to_end(guest)
        return guest

    def rank(self, person: str, rank: Rank) -> None:
        """Put a person, who need not wait, into another rank, behind those who are there."""
        if self._ranks.get(person, Rank.FIRST) is rank:
            return
        guests = self._queue_of(person).pop(person, None)
        if rank is Rank.FIRST:
            del self._ranks[person]
        else:
            self._ranks[person] = rank
        if guests is not None:
            self._queue_of(person)[person] = guests

    def took(self, seconds: float) -> None:
        """So long the last turn has taken."""
        self._taken += seconds

    def leave(self, guest: G) -> None:
        """One has nothing more to say, or has gone; any other does not wait."""
        person = self._persons.pop(guest, None)
        if person is None:
            return
        queue = self._queue_of(person)
        del queue[person][guest]
        if not queue[person]:
            del queue[person]

    def again(self) -> None:
        """The next round begins."""
        self._left, self._taken = self._most, 0.0

    @property
    def used(self) -> bool:
        """Whether a turn of this round was taken."""
        return self._left < self._most

    @property
    def is_full(self) -> bool:
        """Whether no turn is left in this round."""
        return not self._left or self._taken >= self._longest

    def _queue_of(self, person: str) -> OrderedDict[str, OrderedDict[G, None]]:
        return self._queues[self._ranks.get(person, Rank.FIRST)]

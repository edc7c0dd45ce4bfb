"""Whose message is next of all that wait at a host, and when none is for a while: a pure rule."""

from __future__ import annotations

from collections import OrderedDict
from typing import Generic, TypeVar

G = TypeVar("G")


class Turns(Generic[G]):
    """Persons take turns, and the guests of a person among themselves.

    A person with sixty links so has no more than one with a single link, and whoever comes waits for one turn
    of each other person. In a round at most `most` turns are taken, and none more when those have taken
    `longest` seconds. When `next` names nobody, either nobody waits, or all wait for `again`.
    """

    def __init__(self, most: int, longest: float) -> None:
        self._most = self._left = most
        self._longest, self._taken = longest, 0.0
        #: Whoever waits, both in the order of their turns.
        self._waiting: OrderedDict[str, OrderedDict[G, None]] = OrderedDict()
        self._persons: dict[G, str] = {}

    def enter(self, guest: G, person: str) -> None:
        """A guest that does not wait yet has something to say from now on, and is last."""
        self._persons[guest] = person
        self._waiting.setdefault(person, OrderedDict())[guest] = None

    def next(self) -> G | None:
        """Whose turn it is, now and no later: then it waits for the next one, behind all others."""
        if not self._left or self._taken >= self._longest or not self._waiting:
            return None
        self._left -= 1
        person = next(iter(self._waiting))
        guests = self._waiting[person]
        guest = next(iter(guests))
        self._waiting.move_to_end(person)
        guests.move_to_end(guest)
        return guest

    def took(self, seconds: float) -> None:
        """So long the last turn has taken."""
        self._taken += seconds

    def leave(self, guest: G) -> None:
        """One has nothing more to say, or has gone; any other does not wait."""
        person = self._persons.pop(guest, None)
        if person is None:
            return
        del self._waiting[person][guest]
        if not self._waiting[person]:
            del self._waiting[person]

    def again(self) -> None:
        """The next round begins."""
        self._left, self._taken = self._most, 0.0

    @property
    def used(self) -> bool:
        """Whether a turn of this round was taken."""
        return self._left < self._most

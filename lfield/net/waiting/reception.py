"""Where everybody waits who is no host of the team: a few messages of all of them at a time, then a pause."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Protocol

from lfield.net.waiting.turns import Turns

#: So many messages of all that are no hosts are taken in a round, none more when those have taken so many
#: seconds of a processor, and seconds from one round to the next. Whoever asks without an end so keeps a host
#: neither from its guards and peers nor from an emergency stop.
AT_ONCE, LONGEST, ROUND = 16, 0.002, 0.02


class Waiting(Protocol):
    """Somebody of whom more has come than was taken."""

    def take_one(self) -> bool:
        """Take one message, or a part of one; whether there is more."""


class Reception:
    """What has come of them is taken as far as there is room in this round, at once; the rest in the next.

    All calls happen on the thread of a running loop, and `busy` says how long that has been at work.
    """

    def __init__(self, busy: Callable[[], float] = time.thread_time) -> None:
        self._turns: Turns[Waiting] = Turns(AT_ONCE, LONGEST)
        self._busy = busy
        self._timer: asyncio.TimerHandle | None = None

    def enter(self, guest: Waiting, person: str) -> None:
        """There is something to take of a guest of this person that did not wait."""
        self._turns.enter(guest, person)
        if self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(ROUND, self._again)
        self._take()

    def leave(self, guest: Waiting) -> None:
        """A guest has gone; it may not have waited."""
        self._turns.leave(guest)

    def _take(self) -> None:
        began = self._busy()
        while (guest := self._turns.next()) is not None:
            if not guest.take_one():
                self._turns.leave(guest)
            now = self._busy()
            self._turns.took(now - began)
            began = now

    def _again(self) -> None:
        self._timer = None
        self._turns.again()
        self._take()
        if self._turns.used:
            self._timer = asyncio.get_running_loop().call_later(ROUND, self._again)

"""How much processing time the handshakes of callers may take that have not proven who they are.

All of them together have RATION of one processor. Addresses take turns, in three groups that take turns among
themselves: addresses from which a caller has proven who it is, addresses from which none has called, and
those from which the last connection ended without a proof. A caller whose handshake is half done does not
wait behind the new callers of its own address. So a flood from one address, or from many, delays callers from
others by a few handshakes, and a member that comes back from a known address is never kept out. Pure.
"""

from __future__ import annotations

import math
from enum import IntEnum
from ipaddress import IPv6Address, ip_address
from typing import Generic, TypeVar

from lfield.net.waiting.turns import Turns

G = TypeVar("G")

#: The part of one processor for all handshakes of strangers, and seconds of it that they may take at once.
RATION, AT_ONCE = 0.25, 0.005
#: So many addresses are remembered at most of each kind.
MOST_REMEMBERED = 4096


class Trust(IntEnum):
    """What is known of an address."""

    #: Somebody who called from there has proven who it is.
    PROVEN = 0
    NEW = 1
    #: A connection from there ended before anybody had proven who it is.
    FAILED = 2


class Sources:
    """The addresses from which callers came, as far as they are remembered."""

    def __init__(self) -> None:
        self._proven: dict[str, None] = {}
        self._failed: dict[str, None] = {}

    def trust(self, source: str) -> Trust:
        """What is known of an address; one from which somebody was proven stays what it is."""
        if source in self._proven:
            return Trust.PROVEN
        return Trust.FAILED if source in self._failed else Trust.NEW

    def on_proven(self, source: str) -> None:
        """Somebody who called from there has proven who it is, or was called there."""
        _remember(self._proven, source)
        self._failed.pop(source, None)

    def on_failed(self, source: str) -> None:
        """A connection from there ended before anybody had proven who it is."""
        _remember(self._failed, source)


class Handshakes(Generic[G]):
    """Whose handshake goes on next, and when. Times are in seconds of one clock."""

    def __init__(self) -> None:
        self.sources = Sources()
        #: Those that wait, by what was known of their addresses, the next group first.
        self._queues: list[Turns[G]] = [Turns(1, math.inf) for _ in Trust]
        self._by_trust = list(self._queues)
        self._waiting: dict[G, Turns[G]] = {}
        #: The processing time that is not paid off yet, and when that was.
        self._level, self._at = 0.0, 0.0

    def enter(self, guest: G, source: str, *, is_answered: bool) -> None:
        """A part of a handshake has come that did not wait; `is_answered` where it is not the first."""
        queue = self._by_trust[self.sources.trust(source)]
        queue.enter(guest, f"{source} {is_answered}")
        self._waiting[guest] = queue

    def leave(self, guest: G) -> None:
        """One has gone, or has nothing more; it may not have waited."""
        if (queue := self._waiting.pop(guest, None)) is not None:
            queue.leave(guest)

    def next(self, now: float) -> G | None:
        """Whose turn it is, now and no later; None while the budget is used up, or where nobody waits."""
        if self.due(now) > now:
            return None
        for queue in list(self._queues):
            self._queues.append(self._queues.pop(0))
            queue.again()
            if (guest := queue.next()) is not None:
                return guest
        return None

    def took(self, seconds: float, now: float) -> None:
        """So much of a processor the last turn has taken."""
        self._pay(now)
        self._level += max(0.0, seconds)

    def due(self, now: float) -> float:
        """When the next turn may begin; infinite where nobody waits."""
        self._pay(now)
        if not self._waiting:
            return math.inf
        return now if self._level <= AT_ONCE else now + (self._level - AT_ONCE) / RATION

    def _pay(self, now: float) -> None:
        self._level = max(0.0, self._level - RATION * (now - self._at))
        self._at = now


def source_of(address: str) -> str:
    """What counts as one address of callers: without the port, and of IPv6 the network of 64 bits.

    Link-local addresses are all of one network, so each counts for itself.
    """
    host = address.rpartition(":")[0].strip("[]") or address
    try:
        found = ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if isinstance(found, IPv6Address) and not found.is_link_local:
        return str(IPv6Address(int(found) >> 64 << 64))
    return host


def _remember(kept: dict[str, None], source: str) -> None:
    kept.pop(source, None)
    kept[source] = None
    if len(kept) > MOST_REMEMBERED:
        del kept[next(iter(kept))]

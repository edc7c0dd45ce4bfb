"""Scheduler of unauthenticated TLS handshakes: a CPU budget, and round robin over source addresses. Sans-IO.

All handshakes together get CPU_SHARE of one processor. Addresses take turns within three groups, which
alternate: addresses of authenticated callers, unknown addresses, and addresses whose last connection failed
to authenticate. A half-completed handshake precedes new callers of its address. A flood thus delays other
callers by a few handshakes, and does not lock out a member at a known address.
"""

from __future__ import annotations

import math
from enum import IntEnum
from ipaddress import IPv6Address, ip_address
from typing import Generic, TypeVar

from lfield.net.scheduling.fair_queue import FairQueue
from lfield.net.transport import ZENOH, is_zenoh

G = TypeVar("G")

#: Share of one processor for unauthenticated handshakes, and the burst in seconds.
CPU_SHARE, AT_ONCE = 0.25, 0.005
#: Maximum number of addresses remembered of each kind.
MAX_REMEMBERED = 4096


class AddressTrust(IntEnum):
    """Trust in a source address."""

    #: A caller from the address has authenticated.
    PROVEN = 0
    NEW = 1
    #: A connection from the address ended before authentication.
    FAILED = 2


class CallerAddresses:
    """The remembered source addresses."""

    def __init__(self) -> None:
        self._proven: dict[str, None] = {}
        self._failed: dict[str, None] = {}

    def trust(self, source: str) -> AddressTrust:
        """Trust in an address; an address with an authenticated caller remains trusted."""
        if source in self._proven:
            return AddressTrust.PROVEN
        return AddressTrust.FAILED if source in self._failed else AddressTrust.NEW

    def on_proven(self, source: str) -> None:
        """A caller from the address has authenticated, or this host has dialled a peer there."""
        _remember(self._proven, source)
        self._failed.pop(source, None)

    def on_failed(self, source: str) -> None:
        """A connection from the address ended before authentication."""
        _remember(self._failed, source)


class HandshakeScheduler(Generic[G]):
    """Order and time of handshake steps. Times are in seconds of one clock."""

    def __init__(self) -> None:
        self.sources = CallerAddresses()
        #: Waiting links by trust of their address; the next group first.
        self._queues: list[FairQueue[G]] = [FairQueue(1, math.inf) for _ in AddressTrust]
        self._by_trust = list(self._queues)
        self._waiting: dict[G, FairQueue[G]] = {}
        #: CPU time not yet repaid, and the time of that value.
        self._level, self._at = 0.0, 0.0

    def add(self, link: G, source: str, *, is_answered: bool) -> None:
        """Add a handshake step of a link that did not wait; `is_answered` if it is not the first step."""
        queue = self._by_trust[self.sources.trust(source)]
        queue.add(link, f"{source} {is_answered}")
        self._waiting[link] = queue

    def remove(self, link: G) -> None:
        """Remove a closed or idle link; ignored if it does not wait."""
        if (queue := self._waiting.pop(link, None)) is not None:
            queue.remove(link)

    def next(self, now: float) -> G | None:
        """The link whose step is next; None if the budget is used up or no link waits."""
        if self.due(now) > now:
            return None
        for queue in list(self._queues):
            self._queues.append(self._queues.pop(0))
            queue.start_round()
            if (client := queue.next()) is not None:
                return client
        return None

    def charge(self, seconds: float, now: float) -> None:
        """Charge the last step with its CPU time."""
        self._refill(now)
        self._level += max(0.0, seconds)

    def due(self, now: float) -> float:
        """The time when the next step may start; infinite if none waits."""
        self._refill(now)
        if not self._waiting:
            return math.inf
        return now if self._level <= AT_ONCE else now + (self._level - AT_ONCE) / CPU_SHARE

    def _refill(self, now: float) -> None:
        self._level = max(0.0, self._level - CPU_SHARE * (now - self._at))
        self._at = now


def source_of(address: str) -> str:
    """The source of an address for rationing: without port, and the /64 of IPv6.

    Link-local addresses share one network, so each of them counts separately.
    """
    if is_zenoh(address):
        # A caller chooses its inbox in a fabric, so all callers of a fabric count as one source.
        return ZENOH
    host = address.rpartition(":")[0].strip("[]") or address
    try:
        found = ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if isinstance(found, IPv6Address) and not found.is_link_local:
        return str(IPv6Address(int(found) >> 64 << 64))
    return host


def _remember(sources: dict[str, None], source: str) -> None:
    sources.pop(source, None)
    sources[source] = None
    if len(sources) > MAX_REMEMBERED:
        del sources[next(iter(sources))]

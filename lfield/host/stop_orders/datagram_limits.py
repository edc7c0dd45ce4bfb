"""Rate limits for datagrams and signature checks of a host. Sans-IO: times in seconds are passed in.

A signature check takes 0.15 ms of CPU time. A flood must use up neither the CPU nor the checks of an operator
who stops the team, so there are token buckets:

- each sender (address and port) has one for decoded datagrams and one for checks, and all senders of one
  address together have one for decoded datagrams;
- all senders of one address (of a /64 with IPv6) have at most half of the capacity for unverified senders;
- unverified senders that name a certificate known here share one bucket, and all others another one;
- a sender with a valid signature has a bucket with its certificate, which other senders drain only with
  datagrams that forge the address of this sender.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from typing import NamedTuple, TypeVar

K = TypeVar("K")
V = TypeVar("V")

#: The number of remembered senders, addresses, and senders with a valid signature.
MAX_KEYS = 1024


class Rate(NamedTuple):
    """Burst size, and sustained rate per second."""

    burst: float
    each_second: float


#: The rates of datagrams of one sender, and of all senders of one address, that are decoded; others are
#: dropped unread.
DECODES, ADDRESS_DECODES = Rate(64.0, 32.0), Rate(256.0, 128.0)
#: Checks for one sender without a valid signature so far, for one address, for all that name a known
#: certificate, and for all others, whose certificates need a check too.
SENDER, ADDRESS, KNOWN, UNKNOWN = Rate(6.0, 3.0), Rate(25.0, 20.0), Rate(50.0, 40.0), Rate(50.0, 40.0)
#: Checks of one sender with a certificate with which it has sent a valid signature.
PROVEN = Rate(20.0, 10.0)


class Sender(NamedTuple):
    """The source of a datagram. `network` is the address, with IPv6 its first 64 bits."""

    network: str
    address: Hashable


class _Buckets:
    """A bucket of the same rate for each key; least recently used ones are forgotten."""

    def __init__(self, rate: Rate) -> None:
        self._rate = rate
        self._levels: OrderedDict[Hashable, tuple[float, float]] = OrderedDict()

    def level(self, key: Hashable, now: float) -> float:
        level, since = self._levels.get(key, (self._rate.burst, now))
        return min(self._rate.burst, level + max(0.0, now - since) * self._rate.each_second)

    def consume(self, key: Hashable, now: float) -> None:
        """Take one token."""
        remember_newest(self._levels, key, (self.level(key, now) - 1.0, now), MAX_KEYS)


class DatagramLimits:
    """The buckets of all senders of datagrams."""

    def __init__(self) -> None:
        self._decodes, self._address_decodes = _Buckets(DECODES), _Buckets(ADDRESS_DECODES)
        self._senders, self._networks = _Buckets(SENDER), _Buckets(ADDRESS)
        self._buckets_of_all = {True: _Buckets(KNOWN), False: _Buckets(UNKNOWN)}
        self._checks = _Buckets(PROVEN)
        self._proven: OrderedDict[tuple[Sender, bytes], None] = OrderedDict()

    def may_decode(self, sender: Sender, now: float) -> bool:
        """Whether a datagram from this sender is decoded; if so, it is counted."""
        network = sender.network
        if min(self._decodes.level(sender, now), self._address_decodes.level(network, now)) < 1.0:
            return False
        self._decodes.consume(sender, now)
        self._address_decodes.consume(network, now)
        return True

    def may_check(self, sender: Sender, signer: bytes, now: float, *, is_known: bool) -> bool:
        """Whether a signature is checked; if so, it is counted. `is_known`: the certificate of the digest
        `signer` was verified here before.
        """
        pair = (sender, signer)
        if pair in self._proven:
            budgets: list[tuple[_Buckets, Hashable]] = [(self._checks, pair)]
        else:
            buckets_of_all = self._buckets_of_all[is_known]
            budgets = [(self._senders, sender), (self._networks, sender.network), (buckets_of_all, None)]
        if any(buckets.level(key, now) < 1.0 for buckets, key in budgets):
            return False
        for buckets, key in budgets:
            buckets.consume(key, now)
        return True

    def on_proven(self, sender: Sender, signer: bytes) -> None:
        """A signature of this sender with this certificate was valid."""
        remember_newest(self._proven, (sender, signer), None, MAX_KEYS)


def remember_newest(entries: OrderedDict[K, V], key: K, value: V, limit: int) -> None:
    """Append an entry, and drop the first if there are more than `limit`."""
    entries[key] = value
    entries.move_to_end(key)
    if len(entries) > limit:
        entries.popitem(last=False)

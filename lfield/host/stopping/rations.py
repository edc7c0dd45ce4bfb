"""How many datagrams and signatures a host looks at, and of whom. Pure: times in seconds are given.

A check of a signature takes 0.15 ms of a processor. A flood must take neither the processor nor the checks of
a person who stops, so there are limits, each a bucket that fills with time:

- each sender (address and port) has its own, for datagrams that are looked at, and one for checks, and all
  senders of one address together have one for those that are looked at;
- all senders of one address (of a /64 with IPv6) have at most half of what is left to strangers;
- strangers that name a certificate known here have a room of their own, and all others another one;
- a sender whose signature was good once has a bucket with its certificate, which others can empty only with
  datagrams in which they forge that sender's address.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from typing import NamedTuple, TypeVar

K = TypeVar("K")
V = TypeVar("V")

#: So many are remembered, of senders, of addresses and of those whose signature was good.
MOST = 1024


class Rate(NamedTuple):
    """So many at once, and so many a second for long."""

    burst: float
    each_second: float


#: Datagrams of one sender, and of all senders of one address, that are decoded; more are dropped unread.
LOOKS, ADDRESS_LOOKS = Rate(64.0, 32.0), Rate(256.0, 128.0)
#: Checks of one sender whose signature was never good here, of one address, of all that name a certificate
#: that is known here, and of all others, whose certificates take a check too.
SENDER, ADDRESS, KNOWN, UNKNOWN = Rate(6.0, 3.0), Rate(25.0, 20.0), Rate(50.0, 40.0), Rate(50.0, 40.0)
#: Checks of one sender with a certificate with which a signature of it was good here.
PROVEN = Rate(20.0, 10.0)


class Sender(NamedTuple):
    """Where a datagram is from. `network` is the address, with IPv6 its first 64 bits."""

    network: str
    address: Hashable


class _Buckets:
    """A bucket of the same rate for each key; of the least recently used ones the level is forgotten."""

    def __init__(self, rate: Rate) -> None:
        self._rate = rate
        self._levels: OrderedDict[Hashable, tuple[float, float]] = OrderedDict()

    def level(self, key: Hashable, now: float) -> float:
        """How many may be taken now."""
        level, since = self._levels.get(key, (self._rate.burst, now))
        return min(self._rate.burst, level + max(0.0, now - since) * self._rate.each_second)

    def take(self, key: Hashable, now: float) -> None:
        """Take one."""
        remember(self._levels, key, (self.level(key, now) - 1.0, now), MOST)


class Rations:
    """What is left to the senders of datagrams."""

    def __init__(self) -> None:
        self._looks, self._address_looks = _Buckets(LOOKS), _Buckets(ADDRESS_LOOKS)
        self._senders, self._networks = _Buckets(SENDER), _Buckets(ADDRESS)
        self._strangers = {True: _Buckets(KNOWN), False: _Buckets(UNKNOWN)}
        self._checks = _Buckets(PROVEN)
        self._proven: OrderedDict[tuple[Sender, bytes], None] = OrderedDict()

    def may_look(self, sender: Sender, now: float) -> bool:
        """Whether a datagram from there is decoded at all; then it counts."""
        network = sender.network
        if min(self._looks.level(sender, now), self._address_looks.level(network, now)) < 1.0:
            return False
        self._looks.take(sender, now)
        self._address_looks.take(network, now)
        return True

    def may_check(self, sender: Sender, signer: bytes, now: float, *, is_known: bool) -> bool:
        """Whether a signature is checked; then it counts. `is_known`: the certificate of the digest `signer`
        was verified here before."""
        pair = (sender, signer)
        if pair in self._proven:
            taken: list[tuple[_Buckets, Hashable]] = [(self._checks, pair)]
        else:
            strangers = self._strangers[is_known]
            taken = [(self._senders, sender), (self._networks, sender.network), (strangers, None)]
        if any(buckets.level(key, now) < 1.0 for buckets, key in taken):
            return False
        for buckets, key in taken:
            buckets.take(key, now)
        return True

    def proven(self, sender: Sender, signer: bytes) -> None:
        """A signature of this sender with this certificate was good."""
        remember(self._proven, (sender, signer), None, MOST)


def remember(kept: OrderedDict[K, V], key: K, value: V, most: int) -> None:
    """Put it at the end, and forget the first where there are more than `most`."""
    kept[key] = value
    kept.move_to_end(key)
    if len(kept) > most:
        kept.popitem(last=False)

"""Hosts and desks that exchange datagrams over a network that loses and delays them, in virtual time."""

from __future__ import annotations

import heapq
import itertools
import random
from collections.abc import Callable
from functools import cache, partial

from order_host import OrderHost

from lfield.authority.certificate_authority import CertificateAuthority, new_authority
from lfield.authority.identity import ALL_RIGHTS, Right
from lfield.authority.key_material import Keys
from lfield.authority.order_signing.order_signatures import CertificateCache, OrderSigner
from lfield.host.stop_orders.datagram_limits import Sender
from lfield.operator.orders.order_protocol import OrderProtocol, OutgoingDatagram
from lfield.wire.order_messages import Epochs, OrderKind, RelayedAnswer, RelayedOrder

#: When all certificates begin and end, in seconds since 1970 UTC.
AT, ENDS = 1795464000.0, 1795464000.0 + 86400.0


@cache
def authority(number: int) -> CertificateAuthority:
    return new_authority(AT, ENDS + number)


@cache
def keys(holder: str, name: str, may: frozenset[Right] = frozenset(), number: int = 0) -> Keys:
    made = authority(number)
    issued = made.issue(holder, name, may=may, at=AT, ends=ENDS)  # type: ignore[arg-type]
    return Keys(holder, made.certificate, issued.certificate, issued.key)  # type: ignore[arg-type]


def person(name: str = "anna", may: frozenset[Right] = ALL_RIGHTS, number: int = 0) -> Keys:
    return keys("person", name, may, number)


class World:
    """The network. Each datagram is lost with a probability and has a delay; `cut` holds (from, to)."""

    def __init__(self, *hosts: str, loss: float = 0.0, delay: float = 0.01, seed: int = 1) -> None:
        self.now, self.loss, self.delay = 0.0, loss, delay
        self.rng = random.Random(seed)
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()
        self.cut: set[tuple[str, str]] = set()
        #: Every datagram, as (from, to, bytes).
        self.sent: list[tuple[str, str, bytes]] = []
        self.desks: dict[str, OrderingPerson] = {}
        self.posts = {name: Post(self, name) for name in hosts}

    def later(self, seconds: float, event: Callable[[], None]) -> None:
        heapq.heappush(self._events, (self.now + seconds, next(self._count), event))

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        end = self.now + seconds
        while not until() and self._events and self._events[0][0] <= end:
            self.now, _, event = heapq.heappop(self._events)
            event()
        if not until():
            self.now = end

    def carry(self, source: str, target: str, data: bytes, on_arrival: Callable[[], None]) -> None:
        self.sent.append((source, target, data))
        if (source, target) not in self.cut and self.rng.random() >= self.loss:
            self.later(self.delay, on_arrival)


class Post(OrderHost):
    """A host of the world. It has links with all other hosts."""

    def __init__(self, world: World, name: str) -> None:
        self.world, self.name = world, name
        super().__init__(keys("host", name), AT, world.rng, "p.fc", 0.05)

    def now(self) -> float:
        return self.world.now

    def later(self, seconds: float, event: Callable[[], None]) -> None:
        self.world.later(seconds, event)

    def linked(self) -> list[str]:
        return [name for name in self.world.posts if name != self.name]

    def send(self, sender: Sender, data: bytes) -> None:
        desk = str(sender.address)
        if desk in self.world.desks:
            self.world.carry(self.name, desk, data, partial(self.world.desks[desk].on_datagram, data))
        else:
            self.world.sent.append((self.name, desk, data))

    def relay(self, host: str, message: RelayedOrder | RelayedAnswer) -> None:
        handler = partial(self.world.posts[host].datagrams.on_relayed, self.name, message)
        self.world.carry(self.name, host, message.datagram, handler)


class OrderingPerson:
    """A person at a desk who gives one order to hosts."""

    def __init__(
        self,
        world: World,
        kind: OrderKind,
        hosts: dict[str, Epochs],
        who: Keys | None = None,
        *,
        name: str = "desk",
        id: bytes | None = None,
        reason: str = "fog",
    ) -> None:
        self.world, self.name = world, name
        who = who or person()
        certificates = CertificateCache(who.authority)
        order = world.rng.randbytes(16) if id is None else id
        self.asking = OrderProtocol(kind, order, reason, hosts, OrderSigner(who), certificates)
        world.desks[name] = self
        self.given_up = False
        self.done_at: float | None = None
        self.asking.start(world.now)
        self._continue()

    def on_datagram(self, data: bytes) -> None:
        if not self.given_up:
            self.asking.on_datagram(data, self.world.now)
            self._continue()

    def _continue(self) -> None:
        for send in self.asking.drain_effects():
            self._put(send)
        if self.asking.due is not None:
            self.world.later(max(0.0, self.asking.due - self.world.now), self._tick)
        elif self.done_at is None:
            self.done_at = self.world.now

    def _tick(self) -> None:
        due = self.asking.due
        if due is not None and due <= self.world.now and not self.given_up:
            self.asking.tick(self.world.now)
            self._continue()

    def _put(self, send: OutgoingDatagram) -> None:
        handler = partial(self.world.posts[send.host].came, send.datagram, self.name)
        self.world.carry(self.name, send.host, send.datagram, handler)

    @property
    def is_done(self) -> bool:
        return self.done_at is not None

"""Stops over the radios of the benchmark in virtual time: a desk, hosts, and other traffic on the radio.

`make bench ONLY=radio PARTS=virtual` prints the figures, and test_delay_of_stops.py has their bounds.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from unittest import mock

import order_host
from emulator.cells import CELLS, Cell
from emulator.radio_model import Air
from order_world import World, person

from lfield.authority.key_material import Keys
from lfield.authority.order_signing.order_signatures import CertificateCache, OrderSigner, VerifiedCertificate
from lfield.host.events.event_subscription import LONGEST_REST, REST
from lfield.operator.orders import order_protocol
from lfield.operator.orders.order_protocol import EarlierContacts, OrderProtocol
from lfield.wire.order_messages import (
    Epochs,
    Order,
    OrderAnswer,
    SignedAnswer,
    SignedOrder,
    decode_answer,
    decode_order,
)

#: Bytes of an IPv4 and a UDP header.
HEADERS = 28
DESK = "desk"
#: Seconds that a host needs to make its devices safe, and seconds between two stops.
EXECUTES, PAUSE = 0.05, 1.5
#: Bytes/s that each of five hosts sends over its links at rest, without leases and with leases.
IDLE, AT_REST = 80.0, 560.0
#: The traffic of an open `lfield watch` per vehicle: bytes of a batch of telemetry with its headers and of
#: the answer of the desk, and the minimum seconds between two batches. That makes 6.3 kB/s on a fast path, as
#: measured (PARTS=idle of `make bench ONLY=radio`); on a slower one a batch waits as in `EventSubscription`.
BATCH, SEEN, EVERY = 500, 130, 0.1
#: A batch that is not acknowledged is repeated after so many round trips, then after twice the time.
RESENT = 2.0


class _Packet(bytes):
    """A packet, and the function that is called where it arrives."""

    arrived: object


class RadioWorld(World):
    """A team whose datagrams share the emulated radio. `noise`: bytes/s that each host sends beside them, in
    packets of `NOISE` bytes. With `watched` each host sends telemetry to the desk."""

    NOISE = 71

    def __init__(
        self,
        cell: Cell,
        hosts: int,
        seed: int,
        *,
        executes: float = EXECUTES,
        noise: float = 0.0,
        watched: bool = False,
        keeps: bool = False,
    ) -> None:
        names = [f"h{n}" for n in range(hosts)]
        super().__init__(*names, seed=seed)
        self._numbers = {name: number for number, name in enumerate([*names, DESK])}
        self.air = Air([*names, DESK], seed)
        self.air.set_cell(cell)
        self._planned: float | None = None
        #: The round trip of telemetry, in seconds.
        self._trips: dict[str, float] = {}
        self.bytes = 0
        #: Whether `sent` keeps the sent datagrams.
        self._keeps = keeps
        for post in self.posts.values():
            post.slow = executes
            if noise:
                self.later(self.rng.random(), partial(self._noise, post.name, self.NOISE / noise))
            if watched:
                self.later(EVERY * self.rng.random(), partial(self._watch, post.name))

    def _noise(self, name: str, every: float) -> None:
        to = self.rng.choice([other for other in self._numbers if other != name])
        self._send(name, to, bytes(self.NOISE), lambda: None)
        self.later(every * self.rng.uniform(0.5, 1.5), partial(self._noise, name, every))

    def _watch(self, name: str) -> None:
        """Send a batch of telemetry until it is acknowledged; `EventSubscription` paces the next one."""
        sent, is_seen = self.now, False

        def seen() -> None:
            nonlocal is_seen
            if not is_seen:
                is_seen = True
                elapsed = self.now - sent
                trip = self._trips[name] = min(elapsed, self._trips.get(name, elapsed))
                rest = min(LONGEST_REST, REST * (elapsed - trip))
                self.later(max(EVERY - elapsed, rest), partial(self._watch, name))

        def send(again: float) -> None:
            if not is_seen:
                self._send(name, DESK, bytes(BATCH), lambda: self._send(DESK, name, bytes(SEEN), seen))
                self.later(again, partial(send, 2 * again))

        send(RESENT * max(self._trips.get(name, 0.2), 0.1))

    def carry(self, source: str, target: str, data: bytes, taken: Callable[[], None]) -> None:
        self.bytes += len(data) + HEADERS
        if self._keeps:
            self.sent.append((source, target, data))
        self._send(source, target, bytes(len(data) + HEADERS), taken)

    def _send(self, source: str, target: str, data: bytes, taken: Callable[[], None]) -> None:
        packet = _Packet(data)
        packet.arrived = taken
        self.air.send(self.now, self._numbers[source], self._numbers[target], packet)
        self._serve()

    def _serve(self) -> None:
        for delivery in self.air.advance(self.now):
            delivery.packet.arrived()
        at = self.air.next_event()
        if at is not None and (self._planned is None or at < self._planned):
            self._planned = at
            self.later(at - self.now, self._due)

    def _due(self) -> None:
        self._planned = None
        self._serve()


class RadioDesk:
    """A desk that gives orders in sequence, and keeps the state of the hosts."""

    def __init__(self, world: RadioWorld) -> None:
        self.world, self.certificates = world, CertificateCache(person().authority)
        self.epochs = {name: Epochs() for name in world.posts}
        self.trips: dict[str, float] = {}
        self.known: dict[str, VerifiedCertificate | None] = {}
        self.asking: OrderProtocol | None = None
        self.signer = OrderSigner(person())
        self._planned: float | None = None
        world.desks[DESK] = self

    def stop(self) -> Iterator[float]:
        """Stop: seconds until each host has confirmed."""
        world = self.world
        start = world.now
        self.asking = OrderProtocol(
            "stop",
            world.rng.randbytes(16),
            "fog",
            self.epochs,
            self.signer,
            self.certificates,
            EarlierContacts(self.trips, self.known),
        )
        self._planned = None
        self.asking.start(start)
        self._turn()
        done: dict[str, float] = {}

        def over() -> bool:
            for host in self.asking.results:
                done.setdefault(host, world.now - start)
            return len(done) == len(world.posts)

        world.run(60.0, over)
        assert len(done) == len(world.posts)
        asking, self.asking = self.asking, None
        self.epochs, self.trips = dict(asking.epochs), asking.trips
        self.known = {host: self.certificates.of_host(host) for host in world.posts}
        yield from done.values()

    def lifted(self) -> None:
        """Another person lifts the stop, and the desk receives that over its connections."""
        for name, post in self.world.posts.items():
            post.orders.mark_executed("lift", self.world.rng.randbytes(16))
            post.held["stop"] = False
            self.epochs[name] = post.orders.epochs

    def on_datagram(self, data: bytes) -> None:
        if self.asking is not None:
            self.asking.on_datagram(data, self.world.now)
            self._turn()

    def _turn(self) -> None:
        for send in self.asking.drain_effects():
            handler = partial(self.world.posts[send.host].came, send.datagram, DESK)
            self.world.carry(DESK, send.host, send.datagram, handler)
        due = self.asking.due
        if due is not None and due != self._planned:
            self._planned = due
            self.world.later(max(0.0, due - self.world.now), partial(self._tick, self.asking))

    def _tick(self, asking: OrderProtocol) -> None:
        if asking is self.asking:
            asking.tick(self.world.now + 1e-9)
            self._turn()


class Unsigned(OrderSigner):
    """Signs nothing: signatures would take most of the time, and virtual time does not measure them."""

    known: dict[bytes, VerifiedCertificate] = {}

    def __init__(self, keys: Keys) -> None:
        super().__init__(keys)
        self._sign = lambda data: bytes(64)
        self.known[self.digest] = VerifiedCertificate(self.certificate, self.identity)


@contextmanager
def unsigned() -> Iterator[None]:
    """Neither make nor check signatures."""
    known = Unsigned.known

    def answered(one: SignedAnswer, *_: object) -> tuple[OrderAnswer, VerifiedCertificate]:
        return decode_answer(one.answer), known[one.signer]

    def ordered(one: SignedOrder, *_: object) -> tuple[Order, VerifiedCertificate]:
        return decode_order(one.order), known[one.signer]

    with ExitStack() as patches:
        for module, name, new in (
            (order_host, "OrderSigner", Unsigned),
            (sys.modules[__name__], "OrderSigner", Unsigned),
            (order_host, "verify_order", ordered),
            (order_protocol, "verify_answer", answered),
        ):
            patches.enter_context(mock.patch.object(module, name, new))
        yield


def stops(
    cell: str, hosts: int, count: int, *, at_rest: float = 0.0, watched: bool = False, again: int = 10
) -> tuple[list[float], float]:
    """Seconds of each stop but the first of each desk, sorted, and the mean number of bytes of a stop."""
    found: list[float] = []
    size = 0
    for seed in range(count // again):
        world = RadioWorld(CELLS[cell], hosts, seed, noise=at_rest, watched=watched)
        desk = RadioDesk(world)
        for number in range(again + 1):
            before = world.bytes
            elapsed = max(desk.stop())
            world.run(PAUSE)
            if number:
                found.append(elapsed)
                size += world.bytes - before
            desk.lifted()
    return sorted(found), size / len(found)

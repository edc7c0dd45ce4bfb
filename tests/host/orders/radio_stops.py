"""Stops over the radios of the benchmark in virtual time: a desk, hosts, and what else the radio carries."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from emulator.air import Air
from emulator.cells import Cell
from order_world import World, person

from lfield.authority.orders.signing import Certificates, Known, Signer
from lfield.operator.orders.asking import Asking
from lfield.wire.orders import Epochs

#: Bytes of an IPv4 and a UDP header.
HEADERS = 28
DESK = "desk"


class _Packet(bytes):
    """A packet, and what is called where it arrives."""

    arrived: object


class RadioWorld(World):
    """A team whose datagrams share the emulated radio. `noise`: bytes/s that each host sends beside them, in
    packets of `NOISE` bytes."""

    NOISE = 71

    def __init__(
        self, cell: Cell, hosts: int, seed: int, *, executes: float, noise: float = 0.0, keeps: bool = False
    ) -> None:
        names = [f"h{n}" for n in range(hosts)]
        super().__init__(*names, seed=seed)
        self._numbers = {name: number for number, name in enumerate([*names, DESK])}
        self.air = Air([*names, DESK], seed)
        self.air.set_cell(cell)
        self._planned: float | None = None
        self.bytes = 0
        #: Whether `sent` has what was sent.
        self._keeps = keeps
        for post in self.posts.values():
            post.slow = executes
            if noise:
                self.later(self.dice.random(), partial(self._noise, post.name, self.NOISE / noise))

    def _noise(self, name: str, every: float) -> None:
        to = self.dice.choice([other for other in self._numbers if other != name])
        self._send(name, to, bytes(self.NOISE), lambda: None)
        self.later(every * self.dice.uniform(0.5, 1.5), partial(self._noise, name, every))

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
    """A desk that gives one order after another, and keeps what it has learned of the hosts."""

    def __init__(self, world: RadioWorld) -> None:
        self.world, self.certificates = world, Certificates(person().authority)
        self.epochs = {name: Epochs() for name in world.posts}
        self.trips: dict[str, float] = {}
        self.known: dict[str, Known | None] = {}
        self.asking: Asking | None = None
        self.signer = Signer(person())
        self._planned: float | None = None
        world.desks[DESK] = self

    def stop(self) -> Iterator[float]:
        """Stop: seconds until each host has confirmed."""
        world = self.world
        start = world.now
        self.asking = Asking(
            "stop",
            world.dice.randbytes(16),
            "fog",
            self.epochs,
            self.signer,
            self.certificates,
            self.trips,
            self.known,
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
        """Somebody lifts the stop, and the desk learns that over its connections."""
        for name, post in self.world.posts.items():
            post.orders.execute("lift", self.world.dice.randbytes(16))
            post.held["stop"] = False
            self.epochs[name] = post.orders.epochs

    def heard(self, data: bytes) -> None:
        if self.asking is not None:
            self.asking.heard(data, self.world.now)
            self._turn()

    def _turn(self) -> None:
        for send in self.asking.take():
            taken = partial(self.world.posts[send.host].came, send.datagram, DESK)
            self.world.carry(DESK, send.host, send.datagram, taken)
        due = self.asking.due
        if due is not None and due != self._planned:
            self._planned = due
            self.world.later(max(0.0, due - self.world.now), partial(self._tick, self.asking))

    def _tick(self, asking: Asking) -> None:
        if asking is self.asking:
            asking.tick(self.world.now + 1e-9)
            self._turn()

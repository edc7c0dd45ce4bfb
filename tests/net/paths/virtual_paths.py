"""Hosts with two paths between them in virtual time: real links over connections that are a model of TCP.

A connection sends in order, and repeats segments that its path has lost. The kernel's counters are those of
the model."""

from __future__ import annotations

import asyncio
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from lfield.errors import AddressError, NoListener
from lfield.hybrid_clock import HybridClock
from lfield.net.framed_link import FramedLink
from lfield.net.health.traffic import Delivery
from lfield.net.link_manager import LinkManager
from lfield.net.link_owner import TeamAddresses
from lfield.net.transport import Link, LinkHandler, split_address
from lfield.simulate.host_fleet import host_at_address
from lfield.simulate.jumping_loop import LoopClock
from lfield.wire.framing import Buffer
from lfield.wire.messages import Control, Hello, Ping

HOSTS = ("alpha", "bravo")
#: Each host's addresses, one on each path.
PLACES = ("one-alpha:7001,two-alpha:7001", "one-bravo:7001,two-bravo:7001")
#: Seconds until a lost segment is repeated.
REPEAT = 0.2


@dataclass
class Path:
    """One-way `delay` in s; a dead path loses everything."""

    delay: float = 0.01
    alive: bool = True


class PathNetwork:
    """The paths, by the first part of an address, and the listeners."""

    def __init__(self) -> None:
        self.paths = {"one": Path(), "two": Path()}
        self.listeners: dict[str, tuple[str, Callable[[Link], LinkHandler]]] = {}
        self.links: list[PathLink] = []

    def path(self, address: str) -> Path:
        return self.paths[split_address(address)[0].partition("-")[0]]


class PathLink(FramedLink):
    """One end of a connection over a path."""

    other: PathLink

    def __init__(self, path: Path, peer: str, machine: str) -> None:
        super().__init__(peer, 1 << 20)
        self.path, self.identity = path, host_at_address(machine)
        self._queue: deque[bytes] = deque()
        self._acked = self._in_flight = 0
        self._is_sending = self._done = False
        self._loop = asyncio.get_running_loop()

    def write(self, data: Buffer) -> None:
        self._queue.append(bytes(data))
        if not self._is_sending:
            self._is_sending = True
            self._loop.call_soon(self._send)

    def _send(self) -> None:
        self._is_sending = bool(self._queue) and not self._done
        if not self._is_sending:
            return
        if not self.path.alive:
            self._loop.call_later(REPEAT, self._send)
            return
        data = self._queue.popleft()
        self._in_flight += 1
        self._loop.call_later(self.path.delay, self.other.deliver, data)
        self._loop.call_later(2 * self.path.delay, self._acknowledge, len(data))
        self._loop.call_soon(self._send)

    def _acknowledge(self, size: int) -> None:
        self._in_flight -= 1
        self._acked += size

    def delivery(self) -> Delivery | None:
        return Delivery(
            self._acked, bool(self._queue or self._in_flight), 2 * self.path.delay, self.path.delay / 4
        )

    def deliver(self, data: bytes) -> None:
        if not self.closed:
            self.received(data)

    def close(self) -> None:
        self.closed = True
        self._loop.call_soon(self.end)
        if self.path.alive:
            self._loop.call_later(self.path.delay, self.other.end)

    abort = close

    def end(self) -> None:
        if not self._done:
            self._done = self.closed = True
            self.on_eof(None)


class PathTransport:
    """The transport of one host."""

    def __init__(self, network: PathNetwork, machine: str) -> None:
        self._network, self._machine = network, machine
        self.dialled: list[tuple[float, str]] = []

    async def listen(self, address: str, on_link: Callable[[Link], LinkHandler]) -> PathListener:
        for each in address.split(","):
            self._network.listeners[each] = self._machine, on_link
        return PathListener(address)

    async def connect(self, address: str, handler: LinkHandler, host: str = "") -> Link:
        loop = asyncio.get_running_loop()
        self.dialled.append((loop.time(), address))
        alive = [each for each in address.split(",") if self._network.path(each).alive]
        if not alive:
            await asyncio.sleep(5.0)
            raise AddressError(address, "no answer")
        path = self._network.path(alive[0])
        await asyncio.sleep(2 * path.delay)
        if alive[0] not in self._network.listeners:
            raise NoListener(address)
        machine, on_link = self._network.listeners[alive[0]]
        prefix = alive[0].partition("-")[0]
        near = PathLink(path, alive[0], machine)
        far = PathLink(path, f"{prefix}-{self._machine}:1", self._machine)
        near.other, far.other = far, near
        near.handler = handler
        far.handler = on_link(far)
        self._network.links += [near, far]
        return near


class PathListener:
    def __init__(self, address: str) -> None:
        self.address = address

    def close(self) -> None:
        """No test connects to a closed listener."""


class PathHost:
    """One of the two hosts; its events are (time, text)."""

    def __init__(self, network: PathNetwork, name: str) -> None:
        self.name, self.other = name, HOSTS[1 - HOSTS.index(name)]
        self.hybrid_clock = HybridClock(0.0, 0.0)
        self.events: list[tuple[float, str]] = []
        self.transport = PathTransport(network, name)
        numbers = {host: number for number, host in enumerate(HOSTS)}
        team = TeamAddresses(numbers, PLACES, HOSTS.index(name), {self.other})
        self.peers = LinkManager(self, self.transport, LoopClock(), random.Random(1), team)

    async def open(self) -> None:
        await self.peers.open(PLACES[HOSTS.index(self.name)])

    @property
    def path(self) -> str:
        """The path of the link; '' without a link."""
        session = self.peers.link_of(self.other)
        return session.link.peer.partition("-")[0] if session is not None else ""

    def send(self, token: int) -> None:
        """Send a message to the other host."""
        self.peers.send(self.other, Ping(token))

    def _note(self, text: str) -> None:
        self.events.append((asyncio.get_running_loop().time(), text))

    def at(self, text: str, since: float = 0.0) -> float:
        """The time of the first event with this text after `since`."""
        return next(at for at, event in self.events if at >= since and text in event)

    def count(self, text: str) -> int:
        return sum(text in event for _, event in self.events)

    # --- LinkOwner

    def hello(self) -> Hello:
        return Hello("host", self.name, 1 + HOSTS.index(self.name))

    def on_linked(self, hello: Hello) -> None:
        self._note(f"linked {self.path}")

    def on_unlinked(self, host: str, *, quietly: bool) -> None:
        self._note("unlinked")

    def desired_hosts(self) -> set[str]:
        return {self.other}

    def on_message(self, host: str, message: Control, link: Link) -> None:
        self._note(f"message {type(message).__name__}")

    def on_transfer(self, *_: object) -> None:
        self._note("transfer")

    on_oversize = on_link_refused = on_transfer

    def note(self, line: str) -> None:
        self._note(str(line))

"""Datagrams: to a vehicle at an address, and from vehicles that send to a port of this computer."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Iterable
from contextlib import suppress

from lfield.driver.network import Address, Attempts, Lookup
from lfield_mavlink.link.events import AGAIN, ATTEMPT, LinkEvents, OnData, cannot_open, name_of, reason_of

#: Peers that a listening port answers.
PEERS = 16
#: Bytes of the largest datagram.
LARGEST = 65535
#: Seconds without a datagram after which the name is resolved anew, and a socket to a vehicle opened anew: it
#: keeps this computer's address of when it was opened, which may not be there any more.
SILENT = 3.0


class _Sockets:
    """The open sockets of a link. `on_datagram` takes one that came, `on_error` that one could not be read.

    Sockets of its own on the loop, of which one datagram is read at a time: the task that waits for it runs
    before the next one is read.
    """

    def __init__(
        self, on_datagram: Callable[[socket.socket, bytes, Address], None], on_error: Callable[[], None]
    ) -> None:
        self._on_datagram, self._on_error = on_datagram, on_error
        self.open: list[socket.socket] = []

    def add(self, opened: socket.socket) -> None:
        """Read it from now on."""
        self.open.append(opened)
        asyncio.get_running_loop().add_reader(opened, self._receive, opened)

    def _receive(self, opened: socket.socket) -> None:
        try:
            data, peer = opened.recvfrom(LARGEST)
        except OSError:
            self._on_error()
            return
        self._on_datagram(opened, data, peer)

    def remove(self, opened: socket.socket) -> None:
        """Close it."""
        self.open.remove(opened)
        asyncio.get_running_loop().remove_reader(opened)
        opened.close()

    def close(self) -> None:
        """Close them all."""
        for opened in tuple(self.open):
            self.remove(opened)


def _places(found: Iterable[tuple[int, Address]]) -> str:
    return ", ".join(str(address[0]) for _, address in found)


class UdpLink:
    """Datagrams to one peer, that answers from where it is sent to."""

    def __init__(self, host: str, port: int, on_data: OnData, events: LinkEvents) -> None:
        self._lookup = Lookup(host, port, socket.SOCK_DGRAM)
        self._name = name_of("udp", self._lookup.host, port)
        self._on_data, self._events = on_data, events
        self._attempts = Attempts(self._name)
        self._sockets = _Sockets(self._on_datagram, self._on_error)
        self._task: asyncio.Task[None] | None = None
        self._at, self._heard, self._turn = 0.0, False, 0
        # Whether the other computer has said that nobody listens there.
        self._unreachable = False

    async def open(self) -> None:
        """Resolve its name and connect the socket. Raises DeviceError."""
        try:
            await self._connect()
        except OSError as error:
            raise cannot_open(self._name, error) from None
        self._task = asyncio.get_running_loop().create_task(self._keep())

    async def _connect(self) -> str:
        """A new socket to the next of its addresses, which is returned. Raises OSError."""
        found = await self._lookup.addresses(ATTEMPT)
        family, address = found[self._turn % len(found)]
        self._turn += 1
        opened = socket.socket(family, socket.SOCK_DGRAM)
        try:
            opened.setblocking(False)
            opened.connect(address)
        except OSError:
            opened.close()
            raise
        self._sockets.close()
        self._sockets.add(opened)
        self._at = asyncio.get_running_loop().time()
        return str(address[0])

    async def _keep(self) -> None:
        """Connect anew whenever nothing has come for a while, until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(AGAIN)
            if loop.time() - self._at < SILENT:
                continue
            if self._heard:
                self._events.log(self._attempts.lost(f"nothing came for {SILENT:g} s", loop.time()))
            try:
                where = await self._connect()
            except OSError as error:
                self._events.log(self._attempts.failed(reason_of(error), loop.time()))
            else:
                self._events.log(self._attempts.opened(f"it sends to {where}", loop.time()))

    def _on_datagram(self, _: socket.socket, data: bytes, __: Address) -> None:
        """A packet from the vehicle."""
        self._at, self._heard, self._unreachable = asyncio.get_running_loop().time(), True, False
        # An address that answers is kept for the next time.
        self._attempts.works()
        self._on_data(data)

    def _on_error(self) -> None:
        """Nobody listens there yet; the heartbeat says when somebody does."""
        self._unreachable = True

    def send(self, data: bytes) -> None:
        """To the peer."""
        for opened in self._sockets.open:
            with suppress(OSError):
                opened.send(data)

    def send_to(self, data: bytes, address: str) -> None:
        """To the peer: there is one far end."""
        self.send(data)

    def why_silent(self) -> str:
        """Simulators do not listen on UDP as radios and routers do: which endpoint is meant instead."""
        nobody = "nobody listens at" if self._unreachable else "nothing comes back from"
        return (
            f"{nobody} {self._name}; a simulator is met otherwise: ArduPilot's at tcp:127.0.0.1:5760, "
            "and PX4's sends to udpin:127.0.0.1:14550 and 14540"
        )

    def close(self) -> None:
        """Close the socket."""
        if self._task is not None:
            self._task.cancel()
        self._sockets.close()


class UdpListener:
    """Datagrams from all that send to a port; each is answered where it sends from.

    Several vehicles may send to one port; each leaves alone what is addressed to another.
    """

    def __init__(self, host: str, port: int, on_data: OnData, events: LinkEvents) -> None:
        self._lookup = Lookup(host, port, socket.SOCK_DGRAM)
        self._name = name_of("udp", self._lookup.host, port)
        self._on_data, self._events = on_data, events
        self._endpoint = name_of("udpin", self._lookup.host, port)
        self._attempts = Attempts(self._endpoint)
        self._sockets = _Sockets(self._on_datagram, lambda: None)
        self._task: asyncio.Task[None] | None = None
        self._bound: dict[tuple[int, Address], socket.socket] = {}
        #: The addresses of its name at which it could not be bound, tried again every AGAIN s.
        self._unbound: list[tuple[int, Address]] = []
        self._at = 0.0
        self._peers: dict[str, tuple[socket.socket, Address]] = {}

    async def open(self) -> None:
        """Bind the sockets. Raises DeviceError."""
        try:
            failure = self._bind(await self._lookup.addresses(ATTEMPT))
            if not self._bound:
                raise failure or OSError("it has no address")
        except OSError as error:
            raise cannot_open(self._name, error) from None
        if failure is not None:
            now = asyncio.get_running_loop().time()
            # Attempts are counted from here, and the line is that of the first.
            self._attempts.lost("", now)
            self._events.log(self._attempts.failed(reason_of(failure), now))
        self._task = asyncio.get_running_loop().create_task(self._keep())

    def _bind(self, found: list[tuple[int, Address]]) -> OSError | None:
        """Bind a socket at each of these addresses that has none; why that failed where it did."""
        failures: dict[tuple[int, Address], OSError] = {}
        for at in found:
            if at in self._bound:
                continue
            made = socket.socket(at[0], socket.SOCK_DGRAM)
            try:
                made.setblocking(False)
                made.bind(at[1])
            except OSError as error:
                made.close()
                failures[at] = error
            else:
                self._bound[at] = made
                self._sockets.add(made)
        self._unbound = list(failures)
        reasons = [f"{at[1][0]}: {reason_of(error)}" for at, error in failures.items()]
        return OSError("; ".join(reasons)) if reasons else None

    def _unbind(self, found: list[tuple[int, Address]]) -> None:
        """Close the sockets at addresses other than these."""
        for at in self._bound.keys() - set(found):
            gone = self._bound.pop(at)
            self._sockets.remove(gone)
            for address in [address for address, (opened, _) in self._peers.items() if opened is gone]:
                del self._peers[address]

    async def _keep(self) -> None:
        """Bind what could not be bound; while nothing comes, follow the name to its addresses of now."""
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(AGAIN)
            before = set(self._bound)
            try:
                if loop.time() - self._at >= SILENT or not self._bound:
                    found = await self._lookup.addresses(ATTEMPT)
                    if set(found) != before.union(self._unbound):
                        places = _places(found)
                        self._events.log(self._attempts.lost(f"its address is {places} now", loop.time()))
                    self._unbind(found)
                else:
                    found = self._unbound
                failure = self._bind(found)
            except OSError as error:
                failure = error
            if failure is not None:
                self._events.log(self._attempts.failed(reason_of(failure), loop.time()))
            if more := [at for at in self._bound if at not in before]:
                self._events.log(self._attempts.opened(f"it listens at {_places(more)}", loop.time()))
                if failure is None:
                    self._attempts.works()

    def _on_datagram(self, opened: socket.socket, data: bytes, peer: Address) -> None:
        """A packet from a vehicle."""
        self._at = asyncio.get_running_loop().time()
        if not self._unbound:
            self._attempts.works()
        # The newest is last; the one that was silent longest is forgotten.
        host, port = str(peer[0]), peer[1]
        address = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        self._peers.pop(address, None)
        self._peers[address] = (opened, peer)
        if len(self._peers) > PEERS:
            del self._peers[next(iter(self._peers))]
        self._events.sender(address)
        self._on_data(data)

    def send(self, data: bytes) -> None:
        """To the peers, if there are any."""
        for address in tuple(self._peers):
            self.send_to(data, address)

    def send_to(self, data: bytes, address: str) -> None:
        """To one of them, as long as it is known."""
        if address in self._peers:
            opened, peer = self._peers[address]
            with suppress(OSError):
                opened.sendto(data, peer)

    def why_silent(self) -> str:
        """Nobody sends."""
        return f"nothing comes to {self._endpoint}; does the vehicle, the simulator or the router send there?"

    def close(self) -> None:
        """Close the sockets."""
        if self._task is not None:
            self._task.cancel()
        self._sockets.close()

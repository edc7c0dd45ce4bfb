"""UDP links: to a vehicle at an address, and from vehicles that send to a port of this computer."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Iterable
from contextlib import suppress

from lfield.driver.network import Address, Attempts, Lookup
from lfield_mavlink.link.link_events import (
    ATTEMPT_TIMEOUT,
    RETRY_INTERVAL,
    LinkEvents,
    OnData,
    cannot_open,
    name_of,
    reason_of,
)

#: Peers of a listening port.
PEERS = 16
#: Bytes of the largest datagram.
LARGEST = 65535
#: Seconds without a datagram after which the name is resolved again and the socket reopened: it is bound to a
#: local address that may be gone.
SILENT = 3.0


class _Sockets:
    """The open sockets of a link. `on_datagram` gets a datagram, `on_error` a failed read.

    Registered directly with the loop; one datagram is read per iteration, so that the task that waits for it
    runs before the next one is read.
    """

    def __init__(
        self, on_datagram: Callable[[socket.socket, bytes, Address], None], on_error: Callable[[], None]
    ) -> None:
        self._on_datagram, self._on_error = on_datagram, on_error
        self.open: list[socket.socket] = []

    def add(self, open_socket: socket.socket) -> None:
        """Reads from a socket from now on."""
        self.open.append(open_socket)
        asyncio.get_running_loop().add_reader(open_socket, self._receive, open_socket)

    def _receive(self, open_socket: socket.socket) -> None:
        try:
            data, peer = open_socket.recvfrom(LARGEST)
        except OSError:
            self._on_error()
            return
        self._on_datagram(open_socket, data, peer)

    def remove(self, open_socket: socket.socket) -> None:
        """Closes a socket."""
        self.open.remove(open_socket)
        asyncio.get_running_loop().remove_reader(open_socket)
        open_socket.close()

    def close(self) -> None:
        for open_socket in tuple(self.open):
            self.remove(open_socket)


def _places(addresses: Iterable[tuple[int, Address]]) -> str:
    return ", ".join(str(address[0]) for _, address in addresses)


class UdpLink:
    """Datagrams to and from one peer."""

    def __init__(self, host: str, port: int, on_data: OnData, events: LinkEvents) -> None:
        self._lookup = Lookup(host, port, socket.SOCK_DGRAM)
        self._name = name_of("udp", self._lookup.host, port)
        self._on_data, self._events = on_data, events
        self._attempts = Attempts(self._name)
        self._sockets = _Sockets(self._on_datagram, self._on_error)
        self._task: asyncio.Task[None] | None = None
        self._last_activity, self._has_received, self._address_index = 0.0, False, 0
        # Whether the peer's computer has reported a closed port.
        self._unreachable = False

    async def open(self) -> None:
        """Resolves the name and connects the socket. Raises DeviceError."""
        try:
            await self._connect()
        except OSError as error:
            raise cannot_open(self._name, error) from None
        self._task = asyncio.get_running_loop().create_task(self._run())

    async def _connect(self) -> str:
        """Opens a socket to the next of its addresses and returns the address. Raises OSError."""
        addresses = await self._lookup.addresses(ATTEMPT_TIMEOUT)
        family, address = addresses[self._address_index % len(addresses)]
        self._address_index += 1
        open_socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            open_socket.setblocking(False)
            open_socket.connect(address)
        except OSError:
            open_socket.close()
            raise
        self._sockets.close()
        self._sockets.add(open_socket)
        self._last_activity = asyncio.get_running_loop().time()
        return str(address[0])

    async def _run(self) -> None:
        """Reconnects whenever nothing has arrived for a while, until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(RETRY_INTERVAL)
            if loop.time() - self._last_activity < SILENT:
                continue
            if self._has_received:
                self._events.log(self._attempts.lost(f"no data for {SILENT:g} s", loop.time()))
            try:
                address = await self._connect()
            except OSError as error:
                self._events.log(self._attempts.failed(reason_of(error), loop.time()))
            else:
                self._events.log(self._attempts.opened(f"it sends to {address}", loop.time()))

    def _on_datagram(self, _: socket.socket, data: bytes, __: Address) -> None:
        """Handles a packet from the vehicle."""
        self._last_activity, self._has_received, self._unreachable = (
            asyncio.get_running_loop().time(),
            True,
            False,
        )
        # Keep an address that answers.
        self._attempts.works()
        self._on_data(data)

    def _on_error(self) -> None:
        """Records that the port of the peer is closed; a later heartbeat will succeed."""
        self._unreachable = True

    def send(self, data: bytes) -> None:
        """Sends to the peer."""
        for open_socket in self._sockets.open:
            with suppress(OSError):
                open_socket.send(data)

    def send_to(self, data: bytes, address: str) -> None:
        """Sends to the peer; there is only one."""
        self.send(data)

    def silence_reason(self) -> str:
        """The text for a silent peer; simulators do not listen on UDP, so it names the endpoint to use
        instead.
        """
        problem = "no process listens at" if self._unreachable else "nothing received from"
        return (
            f"{problem} {self._name}; simulators use other endpoints: ArduPilot's is tcp:127.0.0.1:5760, and "
            "PX4's sends to udpin:127.0.0.1:14550 and 14540"
        )

    def close(self) -> None:
        """Closes the socket."""
        if self._task is not None:
            self._task.cancel()
        self._sockets.close()


class UdpListener:
    """Datagrams from all that send to a port; each peer is answered at its address.

    Several vehicles may send to one port; each ignores messages for another.
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
        #: Addresses of its name that could not be bound, retried every RETRY_INTERVAL s.
        self._unbound: list[tuple[int, Address]] = []
        self._last_activity = 0.0
        self._peers: dict[str, tuple[socket.socket, Address]] = {}

    async def open(self) -> None:
        """Binds the sockets. Raises DeviceError."""
        try:
            failure = self._bind(await self._lookup.addresses(ATTEMPT_TIMEOUT))
            if not self._bound:
                raise failure or OSError("it has no address")
        except OSError as error:
            raise cannot_open(self._name, error) from None
        if failure is not None:
            now = asyncio.get_running_loop().time()
            # Attempts are counted from here; the log line is that of the first.
            self._attempts.lost("", now)
            self._events.log(self._attempts.failed(reason_of(failure), now))
        self._task = asyncio.get_running_loop().create_task(self._run())

    def _bind(self, addresses: list[tuple[int, Address]]) -> OSError | None:
        """Binds a socket at each unbound address; returns the error, if any."""
        failures: dict[tuple[int, Address], OSError] = {}
        for address in addresses:
            if address in self._bound:
                continue
            bound_socket = socket.socket(address[0], socket.SOCK_DGRAM)
            try:
                bound_socket.setblocking(False)
                bound_socket.bind(address[1])
            except OSError as error:
                bound_socket.close()
                failures[address] = error
            else:
                self._bound[address] = bound_socket
                self._sockets.add(bound_socket)
        self._unbound = list(failures)
        reasons = [f"{address[1][0]}: {reason_of(error)}" for address, error in failures.items()]
        return OSError("; ".join(reasons)) if reasons else None

    def _unbind(self, addresses: list[tuple[int, Address]]) -> None:
        """Closes the sockets at addresses other than these."""
        for address in self._bound.keys() - set(addresses):
            bound_socket = self._bound.pop(address)
            self._sockets.remove(bound_socket)
            for peer in [
                peer for peer, (open_socket, _) in self._peers.items() if open_socket is bound_socket
            ]:
                del self._peers[peer]

    async def _run(self) -> None:
        """Binds missing addresses; while nothing arrives, follows changes of the name's addresses."""
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(RETRY_INTERVAL)
            bound_before = set(self._bound)
            try:
                if loop.time() - self._last_activity >= SILENT or not self._bound:
                    addresses = await self._lookup.addresses(ATTEMPT_TIMEOUT)
                    if set(addresses) != bound_before.union(self._unbound):
                        places = _places(addresses)
                        self._events.log(self._attempts.lost(f"its address is {places} now", loop.time()))
                    self._unbind(addresses)
                else:
                    addresses = self._unbound
                failure = self._bind(addresses)
            except OSError as error:
                failure = error
            if failure is not None:
                self._events.log(self._attempts.failed(reason_of(failure), loop.time()))
            if added := [address for address in self._bound if address not in bound_before]:
                self._events.log(self._attempts.opened(f"it listens at {_places(added)}", loop.time()))
                if failure is None:
                    self._attempts.works()

    def _on_datagram(self, open_socket: socket.socket, data: bytes, peer: Address) -> None:
        """Handles a packet from a vehicle."""
        self._last_activity = asyncio.get_running_loop().time()
        if not self._unbound:
            self._attempts.works()
        # The newest is last; the one that was silent longest is removed.
        host, port = str(peer[0]), peer[1]
        address = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        self._peers.pop(address, None)
        self._peers[address] = (open_socket, peer)
        if len(self._peers) > PEERS:
            del self._peers[next(iter(self._peers))]
        self._events.sender(address)
        self._on_data(data)

    def send(self, data: bytes) -> None:
        """Sends to the peers, if any."""
        for address in tuple(self._peers):
            self.send_to(data, address)

    def send_to(self, data: bytes, address: str) -> None:
        """Sends to one peer while it is known."""
        if address in self._peers:
            open_socket, peer = self._peers[address]
            with suppress(OSError):
                open_socket.sendto(data, peer)

    def silence_reason(self) -> str:
        """The text for a port at which no data was received."""
        return f"nothing received at {self._endpoint}; does the vehicle, simulator or router send there?"

    def close(self) -> None:
        """Closes the sockets."""
        if self._task is not None:
            self._task.cancel()
        self._sockets.close()

"""The sockets at which a host receives datagrams: at the address and port number of each listening socket.

Reading is bounded. A turn of the event loop takes at most AT_ONCE datagrams, and a window of time so much of
the processor; the rest waits in the kernel, which drops what has no room.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from lfield.net.datagrams.kernel_filter import EVERY_PORT, MOST, SECONDS, SHORTEST, Flooder, attach, flooder
from lfield.wire.orders import MAGIC, MAX_DATAGRAM

#: So many datagrams at most are read in a turn of the event loop, and for so many seconds in each WINDOW.
AT_ONCE, WINDOW, SHARE = 32, 0.02, 0.004
#: An address is dropped with all of its ports when so many of them have sent too much.
PORTS = 4
#: What the kernel holds, in bytes, so that a real order is not lost while others are dropped.
BUFFER = 1 << 20


#: An address as sockets have it.
Address = tuple[str, int] | tuple[str, int, int, int]


class Reader(Protocol):
    """Where datagrams go."""

    def received(self, port: DatagramPort, address: Address, data: bytes) -> bool:
        """A datagram that may be an order; False where its sender sends too much, and it is not looked at."""


class DatagramPort:
    """One socket for datagrams, in the running loop. `busy` is the processor time of this thread."""

    def __init__(self, made: socket.socket, reader: Reader, busy: Callable[[], float]) -> None:
        self._socket, self._reader, self._busy = made, reader, busy
        self._loop = asyncio.get_running_loop()
        self._since, self._spent = self._loop.time(), 0.0
        self._waiting: asyncio.TimerHandle | None = None
        #: The senders whose datagrams the kernel drops, each until when.
        self._flooders: dict[Flooder, float] = {}
        attach(made, ())
        self._loop.add_reader(made.fileno(), self._read)

    @property
    def flooders(self) -> list[Flooder]:
        """The senders whose datagrams the kernel drops now."""
        return list(self._flooders)

    def send(self, address: Address, data: bytes) -> None:
        """Send, or drop what the kernel does not take now: the desk repeats."""
        with suppress(OSError):
            self._socket.sendto(data, address)

    def close(self) -> None:
        """Receive no more."""
        if self._waiting is not None:
            self._waiting.cancel()
        self._loop.remove_reader(self._socket.fileno())
        self._socket.close()

    def _read(self) -> None:
        now, began = self._loop.time(), self._busy()
        if now - self._since >= WINDOW:
            self._since, self._spent = now, 0.0
        self._take()
        self._spent += self._busy() - began
        if self._spent > SHARE:
            self._loop.remove_reader(self._socket.fileno())
            self._waiting = self._loop.call_at(self._since + WINDOW, self._go_on)

    def _go_on(self) -> None:
        self._waiting = None
        self._loop.add_reader(self._socket.fileno(), self._read)

    def _take(self) -> None:
        receive, received = self._socket.recvfrom, self._reader.received
        for _ in range(AT_ONCE):
            try:
                data, address = receive(MAX_DATAGRAM + 1)
            except OSError:
                # Nothing is left, or an earlier answer could not be delivered.
                return
            may_be_one = SHORTEST <= len(data) <= MAX_DATAGRAM and data.startswith(MAGIC)
            if may_be_one and not received(self, address, data):
                self._drop(address)

    def _drop(self, address: Address) -> None:
        """Have the kernel drop what this sender sends in the next seconds."""
        found = flooder(address[0], address[1])
        same = [one for one in self._flooders if one.address == found.address]
        if any(one.port == EVERY_PORT for one in same):
            return
        if len(same) >= PORTS:
            for one in same:
                del self._flooders[one]
            found = found._replace(port=EVERY_PORT)
        if found not in self._flooders and len(self._flooders) < MOST:
            if not self._flooders:
                self._loop.call_later(SECONDS, self._forgive)
            self._flooders[found] = self._loop.time() + SECONDS
            attach(self._socket, self._flooders)

    def _forgive(self) -> None:
        """Receive again what is sent by those whose time is over."""
        if self._socket.fileno() < 0:
            return
        now = self._loop.time()
        self._flooders = {found: until for found, until in self._flooders.items() if until > now}
        attach(self._socket, self._flooders)
        if self._flooders:
            self._loop.call_later(min(self._flooders.values()) - now, self._forgive)


class Serving:
    """A server of links, with the socket for datagrams at the same address and port, if there is one."""

    def __init__(self, server: asyncio.Server, port: DatagramPort | None) -> None:
        self._server, self._port = server, port

    def close(self) -> None:
        """Take no more links and no more datagrams."""
        self._server.close()
        if self._port is not None:
            self._port.close()


def beside(listening: socket.socket) -> socket.socket:
    """A socket for datagrams at the address and port of a listening one. Raises OSError."""
    made = socket.socket(listening.family, socket.SOCK_DGRAM)
    try:
        if listening.family == socket.AF_INET6:
            only = listening.getsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY)
            made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, only)
        made.bind(listening.getsockname())
        made.setblocking(False)
        with suppress(OSError):
            made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
    except BaseException:
        made.close()
        raise
    return made


def network_of(address: Address) -> str:
    """The network that an address is rationed with: itself, or the first 64 bits of one of IPv6."""
    if ":" not in address[0]:
        return address[0]
    packed = flooder(address[0], address[1]).address
    return socket.inet_ntop(socket.AF_INET, packed) if len(packed) == 4 else packed[:8].hex()

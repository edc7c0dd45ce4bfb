"""UDP sockets of a host, at the address and port of each listening socket.

Reading is bounded: at most AT_ONCE datagrams per turn of the event loop, and a CPU-time limit per window. The
rest waits in the kernel, which drops datagrams that do not fit.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from lfield.net.datagrams.kernel_filter import (
    ANY_PORT,
    DROP_SECONDS,
    MAX_FLOODERS,
    SHORTEST,
    Flooder,
    attach,
    flooder_at,
)
from lfield.wire.order_messages import MAGIC, MAX_DATAGRAM

#: Maximum datagrams read per turn of the event loop, and maximum seconds of reading per WINDOW.
BATCH, CPU_WINDOW, CPU_BUDGET = 32, 0.02, 0.004
#: An address is dropped with all its ports when this many of them have exceeded the limit.
FLOODING_PORTS = 4
#: Receive buffer of the kernel in bytes, so that an order is not lost during a flood.
RECEIVE_BUFFER = 1 << 20


#: An address as sockets represent it.
Address = tuple[str, int] | tuple[str, int, int, int]


class DatagramReader(Protocol):
    """The receiver of datagrams."""

    def received(self, port: DatagramPort, address: Address, data: bytes) -> bool:
        """Process a datagram that may be an order; False when its sender exceeds the limit."""


class DatagramPort:
    """One UDP socket in the running loop. `busy` is the CPU time of this thread."""

    def __init__(self, udp_socket: socket.socket, reader: DatagramReader, busy: Callable[[], float]) -> None:
        self._socket, self._reader, self._busy = udp_socket, reader, busy
        self._loop = asyncio.get_running_loop()
        self._since, self._spent = self._loop.time(), 0.0
        self._waiting: asyncio.TimerHandle | None = None
        #: The senders dropped by the kernel filter, each with the end of the drop.
        self._flooders: dict[Flooder, float] = {}
        attach(udp_socket, ())
        self._loop.add_reader(udp_socket.fileno(), self._read)

    @property
    def flooders(self) -> list[Flooder]:
        """The senders dropped by the kernel filter now."""
        return list(self._flooders)

    def send(self, address: Address, data: bytes) -> None:
        """Send a datagram, or drop it if the kernel does not accept it now: the desk repeats its orders."""
        with suppress(OSError):
            self._socket.sendto(data, address)

    def close(self) -> None:
        """Stop receiving."""
        if self._waiting is not None:
            self._waiting.cancel()
        self._loop.remove_reader(self._socket.fileno())
        self._socket.close()

    def _read(self) -> None:
        now, start = self._loop.time(), self._busy()
        if now - self._since >= CPU_WINDOW:
            self._since, self._spent = now, 0.0
        self._receive()
        self._spent += self._busy() - start
        if self._spent > CPU_BUDGET:
            self._loop.remove_reader(self._socket.fileno())
            self._waiting = self._loop.call_at(self._since + CPU_WINDOW, self._resume_reading)

    def _resume_reading(self) -> None:
        self._waiting = None
        self._loop.add_reader(self._socket.fileno(), self._read)

    def _receive(self) -> None:
        receive, received = self._socket.recvfrom, self._reader.received
        for _ in range(BATCH):
            try:
                data, address = receive(MAX_DATAGRAM + 1)
            except OSError:
                # No datagram is left, or an earlier answer could not be delivered.
                return
            may_be_order = SHORTEST <= len(data) <= MAX_DATAGRAM and data.startswith(MAGIC)
            if may_be_order and not received(self, address, data):
                self._drop(address)

    def _drop(self, address: Address) -> None:
        """Drop datagrams of this sender in the kernel for the next seconds."""
        flooder = flooder_at(address[0], address[1])
        ports_of_sender = [known for known in self._flooders if known.address == flooder.address]
        if any(known.port == ANY_PORT for known in ports_of_sender):
            return
        if len(ports_of_sender) >= FLOODING_PORTS:
            for known in ports_of_sender:
                del self._flooders[known]
            flooder = flooder._replace(port=ANY_PORT)
        if flooder not in self._flooders and len(self._flooders) < MAX_FLOODERS:
            if not self._flooders:
                self._loop.call_later(DROP_SECONDS, self._unblock_expired)
            self._flooders[flooder] = self._loop.time() + DROP_SECONDS
            attach(self._socket, self._flooders)

    def _unblock_expired(self) -> None:
        """Remove expired senders from the filter."""
        if self._socket.fileno() < 0:
            return
        now = self._loop.time()
        self._flooders = {flooder: until for flooder, until in self._flooders.items() if until > now}
        attach(self._socket, self._flooders)
        if self._flooders:
            self._loop.call_later(min(self._flooders.values()) - now, self._unblock_expired)


class LinkServer:
    """A server of links, and the UDP socket at the same address and port, if any."""

    def __init__(self, server: asyncio.Server, port: DatagramPort | None) -> None:
        self._server, self._port = server, port

    def close(self) -> None:
        """Stop accepting links and datagrams."""
        self._server.close()
        if self._port is not None:
            self._port.close()


def datagram_socket_at(listening: socket.socket) -> socket.socket:
    """A UDP socket at the address and port of a listening socket. Raises OSError."""
    udp_socket = socket.socket(listening.family, socket.SOCK_DGRAM)
    try:
        if listening.family == socket.AF_INET6:
            ipv6_only = listening.getsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY)
            udp_socket.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, ipv6_only)
        udp_socket.bind(listening.getsockname())
        udp_socket.setblocking(False)
        with suppress(OSError):
            udp_socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
    except BaseException:
        udp_socket.close()
        raise
    return udp_socket


def network_of(address: Address) -> str:
    """The network for rationing: an IPv4 address, or the /64 of an IPv6 address."""
    if ":" not in address[0]:
        return address[0]
    packed = flooder_at(address[0], address[1]).address
    return socket.inet_ntop(socket.AF_INET, packed) if len(packed) == 4 else packed[:8].hex()

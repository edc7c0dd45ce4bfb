"""Sends datagrams to hosts and receives their answers: the sockets behind orders."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from typing import Protocol

from lfield.net.connections.resolver import ResolvedAddress, SocketAddress
from lfield.wire.order_messages import MAX_DATAGRAM

#: The maximum number of datagrams read in one turn of the event loop: each may cost a signature check.
MAX_RECEIVED = 16

OnDatagram = Callable[[bytes, SocketAddress], None]


class OrderSocket(Protocol):
    """A socket for datagrams."""

    def send(self, data: bytes, address: ResolvedAddress) -> None:
        """Send a datagram; it may be lost."""

    def close(self) -> None:
        """Stop receiving."""


class OrderSockets:
    """A UDP socket for each family of addresses, made when it is needed, in the running loop.

    A datagram that cannot be sent is lost, as in the network: it is repeated, and a link may follow.
    """

    def __init__(self, on_datagram: OnDatagram) -> None:
        self._on_datagram = on_datagram
        self._sockets: dict[socket.AddressFamily, socket.socket] = {}

    def send(self, data: bytes, address: ResolvedAddress) -> None:
        """See `OrderSocket.send`."""
        try:
            self._socket(address.family).sendto(data, address.address)
        except OSError:
            return

    def _socket(self, family: socket.AddressFamily) -> socket.socket:
        opened = self._sockets.get(family)
        if opened is None:
            opened = socket.socket(family, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
            self._sockets[family] = opened
            asyncio.get_running_loop().add_reader(opened, self._read, opened)
        return opened

    def _read(self, opened: socket.socket) -> None:
        for _ in range(MAX_RECEIVED):
            try:
                data, sender = opened.recvfrom(MAX_DATAGRAM + 1)
            except OSError:
                return
            self._on_datagram(data, sender)

    def close(self) -> None:
        """See `OrderSocket.close`."""
        for opened in self._sockets.values():
            asyncio.get_running_loop().remove_reader(opened)
            opened.close()
        self._sockets.clear()

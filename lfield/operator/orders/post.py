"""Sends datagrams to hosts and receives their answers: the sockets behind orders."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from typing import Protocol

from lfield.net.paths.names import Found, SocketAddress
from lfield.wire.orders import MAX_DATAGRAM

#: So many datagrams are read in one turn of the event loop at most: each may cost a check of a signature.
AT_ONCE = 16

Heard = Callable[[bytes, SocketAddress], None]


class Post(Protocol):
    """Where datagrams go out."""

    def send(self, data: bytes, to: Found) -> None:
        """Send a datagram, or lose it."""

    def close(self) -> None:
        """Receive no more."""


class Sockets:
    """A UDP socket for each family of addresses, made when it is needed, in the running loop.

    What cannot be sent is lost, like what the network loses: it is repeated, and there is the connection.
    """

    def __init__(self, heard: Heard) -> None:
        self._heard = heard
        self._made: dict[socket.AddressFamily, socket.socket] = {}

    def send(self, data: bytes, to: Found) -> None:
        """See `Post.send`."""
        try:
            self._socket(to.family).sendto(data, to.address)
        except OSError:
            return

    def _socket(self, family: socket.AddressFamily) -> socket.socket:
        made = self._made.get(family)
        if made is None:
            made = socket.socket(family, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
            self._made[family] = made
            asyncio.get_running_loop().add_reader(made, self._read, made)
        return made

    def _read(self, made: socket.socket) -> None:
        for _ in range(AT_ONCE):
            try:
                data, sender = made.recvfrom(MAX_DATAGRAM + 1)
            except OSError:
                return
            self._heard(data, sender)

    def close(self) -> None:
        """See `Post.close`."""
        for made in self._made.values():
            asyncio.get_running_loop().remove_reader(made)
            made.close()
        self._made.clear()

"""Accepts connections of browsers and limits those without a session: file descriptors are few.

A connection is unauthenticated until a request on it carries the cookie of a session. At most `MAX_CALLERS`
of these are open at a time, each for at most `LOGIN_TIMEOUT` seconds. So other clients on the network cannot
use up the descriptors that this process needs for the team.
"""

from __future__ import annotations

import asyncio
import random
import socket
import ssl
from collections.abc import Callable
from contextlib import suppress

from lfield.net.connection_limiter import ConnectionLimiter

#: Maximum number of unauthenticated connections, and maximum duration of each (s).
MAX_CALLERS, LOGIN_TIMEOUT = 64, 10.0
#: Seconds until the next attempt, after a connection could not be accepted.
_RETRY_DELAY = 0.1

#: Address and port of a peer, as an ASGI application gets them.
PeerAddress = tuple[str, int]


#: Makes the protocol of a connection.
ProtocolFactory = Callable[[], asyncio.Protocol]


class _AcceptServer:
    """Accepts connections at one socket; implements `Server`."""

    def __init__(self, task: asyncio.Task[None], opened: socket.socket) -> None:
        self._task = task
        task.add_done_callback(lambda _: opened.close())

    def close(self) -> None:
        """Stop accepting and close the socket."""
        self._task.cancel()


class AcceptLimiter:
    """The connections at the sockets of a page; with `tls` over TLS only."""

    def __init__(
        self, tls: ssl.SSLContext | None, rng: random.Random, patience: float = LOGIN_TIMEOUT
    ) -> None:
        self._tls, self._patience = tls, patience
        self._make_protocol: ProtocolFactory | None = None
        self._is_started = asyncio.Event()
        self._unauthenticated: ConnectionLimiter[PeerAddress] = ConnectionLimiter(MAX_CALLERS, rng)
        self._sockets: dict[PeerAddress, socket.socket] = {}
        self._starting: set[asyncio.Task[None]] = set()

    def on_authenticated(self, peer: PeerAddress) -> None:
        """Ends the limit for the connection of a peer that has a session."""
        self._unauthenticated.release(peer)
        self._sockets.pop(peer, None)

    async def serve(self, opened: socket.socket) -> _AcceptServer:
        """Listen at a bound socket; connections wait in the kernel until `start`."""
        opened.setblocking(False)
        opened.listen()
        return _AcceptServer(asyncio.get_running_loop().create_task(self._accept(opened)), opened)

    def start(self, make_protocol: ProtocolFactory) -> None:
        """Accept connections from now on, each with its own protocol object."""
        self._make_protocol = make_protocol
        self._is_started.set()

    async def _accept(self, opened: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        await self._is_started.wait()
        assert self._make_protocol is not None
        while True:
            try:
                connection, name = await loop.sock_accept(opened)
            except OSError:
                # The peer has closed it already, or there is no descriptor left.
                await asyncio.sleep(_RETRY_DELAY)
                continue
            self._admit(connection, (name[0], name[1]))
            task = loop.create_task(self._start(connection, self._make_protocol))
            self._starting.add(task)
            task.add_done_callback(self._starting.discard)

    def _admit(self, connection: socket.socket, peer: PeerAddress) -> None:
        pushed = self._unauthenticated.admit(peer, peer[0])
        if pushed is not None:
            _hang_up(self._sockets.pop(pushed))
        self._sockets[peer] = connection
        asyncio.get_running_loop().call_later(self._patience, self._evict, peer, connection)

    def _evict(self, peer: PeerAddress, connection: socket.socket) -> None:
        """Close a connection that is still unauthenticated, if that port is not in use by a later one."""
        if self._sockets.get(peer) is connection:
            self.on_authenticated(peer)
            _hang_up(connection)

    async def _start(self, connection: socket.socket, make_protocol: ProtocolFactory) -> None:
        loop = asyncio.get_running_loop()
        try:
            await loop.connect_accepted_socket(make_protocol, connection, ssl=self._tls)
        except OSError:
            # The connection is not TLS, or was closed by the peer.
            connection.close()


def _hang_up(connection: socket.socket) -> None:
    """Shut the connection down; its protocol then closes the socket."""
    with suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)

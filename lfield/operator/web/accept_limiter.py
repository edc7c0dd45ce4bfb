"""Takes the calls of browsers, and shows strangers out: anybody may call, and descriptors are few.

A connection is a stranger's until a request on it has brought the cookie of a session. Of those some are held
at a time, and each for some seconds; who brings none has had its sentence by then. So whoever else is on the
network keeps this process from nothing that it does with the team.
"""

from __future__ import annotations

import asyncio
import random
import socket
import ssl
from collections.abc import Callable
from contextlib import suppress

from lfield.net.connection_limiter import ConnectionLimiter

#: So many strangers are held at a time, and each for so many seconds.
MAX_CALLERS, LOGIN_TIMEOUT = 64, 10.0
#: Seconds before the next call is taken, where one could not be.
_RETRY_DELAY = 0.1

#: Who is at the other end of a connection: address and port, as an application (ASGI) is told.
PeerAddress = tuple[str, int]


#: Makes the protocol of a connection.
ProtocolFactory = Callable[[], asyncio.Protocol]


class _AcceptServer:
    """Calls are taken at a socket; implements `Server`."""

    def __init__(self, task: asyncio.Task[None], opened: socket.socket) -> None:
        self._task = task
        task.add_done_callback(lambda _: opened.close())

    def close(self) -> None:
        """Take no more, and close the socket."""
        self._task.cancel()


class AcceptLimiter:
    """Who has called at the sockets of a page; with `tls` each must speak TLS first."""

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
        """Who is at that end has brought a session, and stays."""
        self._unauthenticated.release(peer)
        self._sockets.pop(peer, None)

    async def serve(self, opened: socket.socket) -> _AcceptServer:
        """Listen at a bound socket; the calls wait in the kernel until `start`."""
        opened.setblocking(False)
        opened.listen()
        return _AcceptServer(asyncio.get_running_loop().create_task(self._accept(opened)), opened)

    def start(self, make_protocol: ProtocolFactory) -> None:
        """Take calls from now on; whoever gets through has a protocol of their own."""
        self._make_protocol = make_protocol
        self._is_started.set()

    async def _accept(self, opened: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        await self._is_started.wait()
        assert self._make_protocol is not None
        while True:
            try:
                made, name = await loop.sock_accept(opened)
            except OSError:
                # They hung up again, or there is no descriptor left.
                await asyncio.sleep(_RETRY_DELAY)
                continue
            self._admit(made, (name[0], name[1]))
            task = loop.create_task(self._start(made, self._make_protocol))
            self._starting.add(task)
            task.add_done_callback(self._starting.discard)

    def _admit(self, made: socket.socket, peer: PeerAddress) -> None:
        pushed = self._unauthenticated.admit(peer, peer[0])
        if pushed is not None:
            _hang_up(self._sockets.pop(pushed))
        self._sockets[peer] = made
        asyncio.get_running_loop().call_later(self._patience, self._evict, peer, made)

    def _evict(self, peer: PeerAddress, made: socket.socket) -> None:
        """Unless they are known by now, or somebody else has that port."""
        if self._sockets.get(peer) is made:
            self.on_authenticated(peer)
            _hang_up(made)

    async def _start(self, made: socket.socket, speaks: ProtocolFactory) -> None:
        loop = asyncio.get_running_loop()
        try:
            await loop.connect_accepted_socket(speaks, made, ssl=self._tls)
        except OSError:
            # It was no TLS, or they have gone.
            made.close()


def _hang_up(made: socket.socket) -> None:
    """Whoever has the socket now reads its end, and closes it."""
    with suppress(OSError):
        made.shutdown(socket.SHUT_RDWR)

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

from lfield.net.guests import Guests

#: So many strangers are held at a time, and each for so many seconds.
MOST, PATIENCE = 64, 10.0
#: Seconds before the next call is taken, where one could not be.
_AGAIN = 0.1

#: Who is at the other end of a connection: address and port, as an application (ASGI) is told.
Peer = tuple[str, int]


#: Makes the protocol of a connection.
Speaks = Callable[[], asyncio.Protocol]


class _Taking:
    """Calls are taken at a socket; implements `Server`."""

    def __init__(self, task: asyncio.Task[None], opened: socket.socket) -> None:
        self._task = task
        task.add_done_callback(lambda _: opened.close())

    def close(self) -> None:
        """Take no more, and close the socket."""
        self._task.cancel()


class Callers:
    """Who has called at the sockets of a page; with `tls` each must speak TLS first."""

    def __init__(self, tls: ssl.SSLContext | None, dice: random.Random, patience: float = PATIENCE) -> None:
        self._tls, self._patience = tls, patience
        self._speaks: Speaks | None = None
        self._can_speak = asyncio.Event()
        self._strangers: Guests[Peer] = Guests(MOST, dice)
        self._sockets: dict[Peer, socket.socket] = {}
        self._beginning: set[asyncio.Task[None]] = set()

    def known(self, peer: Peer) -> None:
        """Who is at that end has brought a session, and stays."""
        self._strangers.leave(peer)
        self._sockets.pop(peer, None)

    async def serve(self, opened: socket.socket) -> _Taking:
        """Listen at a bound socket; the calls wait in the kernel until `begin`."""
        opened.setblocking(False)
        opened.listen()
        return _Taking(asyncio.get_running_loop().create_task(self._take(opened)), opened)

    def begin(self, speaks: Speaks) -> None:
        """Take calls from now on; whoever gets through has a protocol of their own."""
        self._speaks = speaks
        self._can_speak.set()

    async def _take(self, opened: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        await self._can_speak.wait()
        assert self._speaks is not None
        while True:
            try:
                made, name = await loop.sock_accept(opened)
            except OSError:
                # They hung up again, or there is no descriptor left.
                await asyncio.sleep(_AGAIN)
                continue
            self._enter(made, (name[0], name[1]))
            task = loop.create_task(self._begin(made, self._speaks))
            self._beginning.add(task)
            task.add_done_callback(self._beginning.discard)

    def _enter(self, made: socket.socket, peer: Peer) -> None:
        pushed = self._strangers.enter(peer, peer[0])
        if pushed is not None:
            _hang_up(self._sockets.pop(pushed))
        self._sockets[peer] = made
        asyncio.get_running_loop().call_later(self._patience, self._show_out, peer, made)

    def _show_out(self, peer: Peer, made: socket.socket) -> None:
        """Unless they are known by now, or somebody else has that port."""
        if self._sockets.get(peer) is made:
            self.known(peer)
            _hang_up(made)

    async def _begin(self, made: socket.socket, speaks: Speaks) -> None:
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

"""Links over TCP, and over Unix sockets of this computer, as asyncio protocols."""

from __future__ import annotations

import asyncio
import os
import socket
import stat
import time
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.errors import AddressError, NobodyListens
from lfield.loop import Simulated
from lfield.net.datagrams.port import DatagramPort, Reader, Serving, beside
from lfield.net.door import socket_address
from lfield.net.paths.call import Call
from lfield.net.paths.listener import PortListener, SocketListener
from lfield.net.paths.reasons import refusal
from lfield.net.stream import StreamLink, TlsLink, nobody_known
from lfield.net.transport import UNIX, split_address
from lfield.net.waiting.reception import Reception

if TYPE_CHECKING:
    from collections.abc import Callable

    from lfield.authority.identity import Identity
    from lfield.net.paths.names import Found
    from lfield.net.tls import Tls
    from lfield.net.transport import Link, LinkHandler, Listener

#: How many callers are let in at once, and how many may wait. Asyncio's own loop takes one number for both:
#: of a crowd it would take more at once than there are descriptors, before any of them can be shown out.
AT_ONCE, WAITING = 1, 128


class TcpTransport:
    """Hosts reached over TCP or a Unix socket ("unix:PATH"), inside a running loop (uvloop's will do).

    `max_block` is the largest block to take and `max_pending` the most bytes to hold for a peer that does
    not read (by default room for four such blocks); a link over it is closed. `connect_timeout` is in
    seconds, and as long again for the handshake. With `tls` both ends of a TCP link prove who they are and
    nobody else can read it; without it whoever is there is a stranger, but where addresses do not lie, as in
    a simulation: `resident` says so. `busy` is the processing time of this thread, by which peers are
    rationed, and `exempt` that part of it which counts for none of them.
    """

    def __init__(
        self,
        max_block: int,
        tls: Tls | None = None,
        *,
        resident: Callable[[str], Identity] = nobody_known,
        max_pending: int | None = None,
        connect_timeout: float = 5.0,
        busy: Callable[[], float] = time.thread_time,
        exempt: Callable[[], float] = float,
    ) -> None:
        self._max_block = max_block
        self._tls, self._resident = tls, resident
        self._max_pending = 4 * max_block + (1 << 20) if max_pending is None else max_pending
        self._connect_timeout = connect_timeout
        self._reception = Reception(busy, exempt)
        #: Where datagrams go that come to the addresses that are listened at; None where none are wanted.
        self.datagrams: Reader | None = None
        self._busy = busy
        #: Takes a line for the log.
        self.note: Callable[[str], None] = lambda text: None
        #: The addresses that have not answered lately.
        self._unanswered: set[Found] = set()

    async def listen(self, address: str, on_link: Callable[[Link], LinkHandler]) -> Listener:
        """Listen at every address of a name that is one of this computer; port 0 takes a free one.

        "[::]" is every address of both families. "fd:N" is the listening socket with that file descriptor,
        inherited from another process. Who may call at "unix:PATH" is for the folder to say: its group may,
        if it may enter it. Raises AddressError.
        """
        loop = asyncio.get_running_loop()
        plain = address.startswith(UNIX)

        def called() -> StreamLink:
            return self._new_link(on_link, plain=plain, calls=False)

        async def serve(made: socket.socket) -> Serving:
            server = await loop.create_server(called, sock=made, backlog=AT_ONCE)
            _let_wait(server)
            return Serving(server, self._datagram_port(made))

        try:
            if address.startswith("fd:"):
                made = socket.socket(fileno=int(address[3:]))
                return SocketListener(await serve(made), socket_address(made.getsockname()))
            if plain:
                path = _path(address)
                server = await loop.create_unix_server(called, sock=_bound(path), backlog=AT_ONCE)
                _let_wait(server)
                return SocketListener(server, address, path)
            if isinstance(loop, Simulated):
                server = await loop.create_server(called, *split_address(address), backlog=AT_ONCE)
                _let_wait(server)
                return SocketListener(server, socket_address(server.sockets[0].getsockname()))
        except (OSError, UnicodeError) as error:
            raise AddressError(address, refusal(error)) from None
        listener = PortListener(address, serve, lambda text: self.note(text))
        await listener.open()
        return listener

    async def connect(self, address: str, handler: LinkHandler) -> Link:
        """A link to whoever listens there. Raises AddressError, NobodyListens if nobody does.

        A name is looked up anew, and its addresses are tried beside each other. GreetingError and WireError
        where the two do not prove to each other who they are.
        """
        loop = asyncio.get_running_loop()
        plain = address.startswith(UNIX)

        def calling() -> StreamLink:
            return self._new_link(lambda _: handler, plain=plain, calls=True)

        call = Call(address, calling, self._unanswered)
        try:
            async with asyncio.timeout(self._connect_timeout) as bound:
                if plain:
                    _, link = await loop.create_unix_connection(calling, str(_path(address)))
                    return link
                if isinstance(loop, Simulated):
                    _, link = await loop.create_connection(calling, *split_address(address))
                    call.link = link
                    await link.ready()
                    return link
                # A path that is back after a while has all the time for the handshake.
                call.on_connected = lambda: bound.reschedule(loop.time() + self._connect_timeout)
                return await call.linked()
        except TimeoutError:
            if call.link is not None:
                call.link.abort()
            raise AddressError(address, call.told(f"no answer within {self._connect_timeout:g} s")) from None
        except (ConnectionRefusedError, FileNotFoundError) as error:
            if call.is_mixed:
                raise AddressError(address, call.told(refusal(error))) from None
            raise NobodyListens(address) from None
        except (OSError, UnicodeError) as error:
            raise AddressError(address, call.told(refusal(error))) from None

    def _datagram_port(self, listening: socket.socket) -> DatagramPort | None:
        """What receives datagrams beside a listening socket. A host stops over links where it cannot."""
        if self.datagrams is None:
            return None
        try:
            return DatagramPort(beside(listening), self.datagrams, self._busy)
        except OSError as error:
            at = socket_address(listening.getsockname())
            self.note(f"cannot receive UDP datagrams at {at}, so stops need a connection: {refusal(error)}")
            return None

    def _new_link(self, on_link: Callable[[Link], LinkHandler], *, plain: bool, calls: bool) -> StreamLink:
        block, pending, reception = self._max_block, self._max_pending, self._reception
        if plain or self._tls is None:
            return StreamLink(block, pending, on_link, reception, self._resident, calls=calls)
        return TlsLink(block, pending, on_link, reception, self._tls, calls=calls)


def _let_wait(server: asyncio.Server) -> None:
    """Have so many callers wait in the kernel, of whom AT_ONCE are accepted at a time."""
    with server.sockets[0].dup() as listening:
        listening.listen(WAITING)


def _path(address: str) -> Path:
    path = Path(address.removeprefix(UNIX))
    if not path.is_absolute():
        raise AddressError(address, "a Unix socket is written unix:/PATH")
    return path


def _bound(path: Path) -> socket.socket:
    """A socket at a path that is free, for whoever may enter its folder."""
    made = socket.socket(socket.AF_UNIX)
    try:
        made.bind(str(path))
        folder = path.parent.stat()
        for_group = folder.st_mode & stat.S_IXGRP
        if for_group and path.lstat().st_gid != folder.st_gid:
            os.chown(path, -1, folder.st_gid)
        path.chmod(0o660 if for_group else 0o600)
    except OSError:
        made.close()
        raise
    return made

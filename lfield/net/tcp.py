"""Links over TCP, and over Unix sockets of this computer, as asyncio protocols."""

from __future__ import annotations

import asyncio
import errno
import os
import socket
import stat
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.errors import AddressError, NobodyListens
from lfield.net.stream import UNIX, StreamLink, TlsLink, nobody_known, socket_address
from lfield.net.transport import split_address
from lfield.net.waiting.reception import Reception

if TYPE_CHECKING:
    from collections.abc import Callable

    from lfield.authority.identity import Identity
    from lfield.net.tls import Tls
    from lfield.net.transport import Link, LinkHandler

_REASONS = {
    errno.EADDRINUSE: "the port is in use; stop the program that has it, or choose another port",
    errno.EADDRNOTAVAIL: "the address is not one of this machine; correct the deployment or map the host",
    errno.EACCES: "this user may not use the port; choose one above 1023",
    errno.EHOSTUNREACH: "there is no way to that machine",
    errno.ENETUNREACH: "there is no way to that network",
}

#: How many callers are let in at once, and how many may wait. Asyncio's own loop takes one number for both:
#: of a crowd it would take more at once than there are descriptors, before any of them can be shown out.
AT_ONCE, WAITING = 1, 128


class TcpTransport:
    """Hosts reached over TCP or a Unix socket ("unix:PATH"), inside a running loop (uvloop's will do).

    `max_block` is the largest block to take and `max_pending` the most bytes to hold for a peer that does
    not read (by default room for four such blocks); a link over it is closed. `connect_timeout` is in
    seconds. With `tls` both ends of a TCP link prove who they are and nobody else can read it; without it
    whoever is there is a stranger, but where addresses do not lie, as in a simulation: `resident` says so.
    """

    def __init__(
        self,
        max_block: int,
        tls: Tls | None = None,
        *,
        resident: Callable[[str], Identity] = nobody_known,
        max_pending: int | None = None,
        connect_timeout: float = 5.0,
    ) -> None:
        self._max_block = max_block
        self._tls, self._resident = tls, resident
        self._max_pending = 4 * max_block + (1 << 20) if max_pending is None else max_pending
        self._connect_timeout = connect_timeout
        self._reception = Reception()

    async def listen(self, address: str, on_link: Callable[[Link], LinkHandler]) -> TcpListener:
        """Listen at exactly that address; port 0 takes a free one. Raises AddressError.

        "fd:N" is the listening socket with that file descriptor, inherited from another process. Who may
        call at "unix:PATH" is for the folder to say: its group may, if it may enter it.
        """
        loop = asyncio.get_running_loop()

        plain = address.startswith(UNIX)

        def called() -> StreamLink:
            return self._new_link(on_link, plain=plain, calls=False)

        try:
            if address.startswith("fd:"):
                inherited = socket.socket(fileno=int(address[3:]))
                server = await loop.create_server(called, sock=inherited, backlog=AT_ONCE)
            elif plain:
                server = await loop.create_unix_server(called, sock=_bound(_path(address)), backlog=AT_ONCE)
            else:
                server = await loop.create_server(called, *split_address(address), backlog=AT_ONCE)
            with server.sockets[0].dup() as listening:
                listening.listen(WAITING)
        except (OSError, UnicodeError) as error:
            raise AddressError(address, refusal(error)) from None
        return TcpListener(server)

    async def connect(self, address: str, handler: LinkHandler) -> Link:
        """A link to whoever listens there. Raises AddressError, NobodyListens if nobody does.

        GreetingError and WireError where the two do not prove to each other who they are.
        """
        loop = asyncio.get_running_loop()
        plain, link = address.startswith(UNIX), None

        def calling() -> StreamLink:
            return self._new_link(lambda _: handler, plain=plain, calls=True)

        try:
            async with asyncio.timeout(self._connect_timeout):
                if plain:
                    _, link = await loop.create_unix_connection(calling, str(_path(address)))
                else:
                    _, link = await loop.create_connection(calling, *split_address(address))
                await link.ready()
        except TimeoutError:
            if link is not None:
                link.abort()
            raise AddressError(address, f"no answer within {self._connect_timeout:g} s") from None
        except (ConnectionRefusedError, FileNotFoundError):
            raise NobodyListens(address) from None
        except (OSError, UnicodeError) as error:
            raise AddressError(address, refusal(error)) from None
        return link

    def _new_link(self, on_link: Callable[[Link], LinkHandler], *, plain: bool, calls: bool) -> StreamLink:
        block, pending, reception = self._max_block, self._max_pending, self._reception
        if plain or self._tls is None:
            return StreamLink(block, pending, on_link, reception, self._resident, calls=calls)
        return TlsLink(block, pending, on_link, reception, self._tls, calls=calls)


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


class TcpListener:
    """An open TCP port, or Unix socket."""

    def __init__(self, server: asyncio.Server) -> None:
        self._server = server
        self.address = socket_address(server.sockets[0].getsockname())

    def close(self) -> None:
        """Take no more links."""
        self._server.close()
        if self.address.startswith(UNIX):
            with suppress(FileNotFoundError):
                _path(self.address).unlink()


def refusal(error: OSError | UnicodeError) -> str:
    """What a socket's error means to the user."""
    if isinstance(error, socket.gaierror | UnicodeError):
        return "the name is not known; correct it, or say where the host is with --map NAME=ADDR:PORT"
    if error.errno in _REASONS:
        return _REASONS[error.errno]
    return os.strerror(error.errno) if error.errno else str(error)

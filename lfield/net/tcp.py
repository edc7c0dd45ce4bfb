"""Links over TCP, and over Unix sockets of this computer, as asyncio protocols."""

from __future__ import annotations

import asyncio
import errno
import os
import socket
import stat
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, cast

from lfield.errors import AddressError, NobodyListens, WireError
from lfield.net.framed import FramedLink
from lfield.net.transport import join_address, split_address

if TYPE_CHECKING:
    from collections.abc import Callable

    from lfield.net.transport import Link, LinkHandler
    from lfield.wire.framing import Buffer

_REASONS = {
    errno.EADDRINUSE: "the port is in use; stop the program that has it, or choose another port",
    errno.EADDRNOTAVAIL: "the address is not one of this machine; correct the deployment or map the host",
    errno.EACCES: "this user may not use the port; choose one above 1023",
    errno.EHOSTUNREACH: "there is no way to that machine",
    errno.ENETUNREACH: "there is no way to that network",
}

#: What the address of a Unix socket begins with; the path follows.
UNIX = "unix:"
#: Whoever called at a Unix socket, in sentences: it has no address.
CALLER = "a command on this computer"

#: How many callers are let in at once, and how many may wait. Asyncio's own loop takes one number for both:
#: of a crowd it would take more at once than there are descriptors, before any of them can be shown out.
AT_ONCE, WAITING = 1, 128
#: Seconds that a peer has to take the last words of a link that is closed.
LAST_WORDS = 5.0


class TcpTransport:
    """Hosts reached over TCP or a Unix socket ("unix:PATH"), inside a running loop (uvloop's will do).

    `max_block` is the largest block to take and `max_pending` the most bytes to hold for a peer that does
    not read (by default room for four such blocks); a link over it is closed. `connect_timeout` is in
    seconds.
    """

    def __init__(
        self, max_block: int, *, max_pending: int | None = None, connect_timeout: float = 5.0
    ) -> None:
        self._max_block = max_block
        self._max_pending = 4 * max_block + (1 << 20) if max_pending is None else max_pending
        self._connect_timeout = connect_timeout

    async def listen(self, address: str, on_link: Callable[[Link], LinkHandler]) -> TcpListener:
        """Listen at exactly that address; port 0 takes a free one. Raises AddressError.

        "fd:N" is the listening socket with that file descriptor, inherited from another process. Who may
        call at "unix:PATH" is for the folder to say: its group may, if it may enter it.
        """
        loop = asyncio.get_running_loop()

        def called() -> _TcpLink:
            return self._new_link(on_link)

        try:
            if address.startswith("fd:"):
                inherited = socket.socket(fileno=int(address[3:]))
                server = await loop.create_server(called, sock=inherited, backlog=AT_ONCE)
            elif address.startswith(UNIX):
                server = await loop.create_unix_server(called, sock=_bound(_path(address)), backlog=AT_ONCE)
            else:
                server = await loop.create_server(called, *split_address(address), backlog=AT_ONCE)
            with server.sockets[0].dup() as listening:
                listening.listen(WAITING)
        except (OSError, UnicodeError) as error:
            raise AddressError(address, refusal(error)) from None
        return TcpListener(server)

    async def connect(self, address: str, handler: LinkHandler) -> Link:
        """A link to whoever listens there. Raises AddressError, NobodyListens if nobody does."""
        loop = asyncio.get_running_loop()

        def calling() -> _TcpLink:
            return self._new_link(lambda _: handler)

        try:
            async with asyncio.timeout(self._connect_timeout):
                if address.startswith(UNIX):
                    _, link = await loop.create_unix_connection(calling, str(_path(address)))
                else:
                    _, link = await loop.create_connection(calling, *split_address(address))
        except TimeoutError:
            raise AddressError(address, f"no answer within {self._connect_timeout:g} s") from None
        except (ConnectionRefusedError, FileNotFoundError):
            raise NobodyListens(address) from None
        except (OSError, UnicodeError) as error:
            raise AddressError(address, refusal(error)) from None
        return link

    def _new_link(self, on_link: Callable[[Link], LinkHandler]) -> _TcpLink:
        return _TcpLink(self._max_block, self._max_pending, on_link)


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
        path.chmod(0o660 if path.parent.stat().st_mode & stat.S_IXGRP else 0o600)
    except OSError:
        made.close()
        raise
    return made


class TcpListener:
    """An open TCP port, or Unix socket."""

    def __init__(self, server: asyncio.Server) -> None:
        self._server = server
        self.address = _socket_address(server.sockets[0].getsockname())

    def close(self) -> None:
        """Take no more links."""
        self._server.close()
        if self.address.startswith(UNIX):
            with suppress(FileNotFoundError):
                _path(self.address).unlink()


class _TcpLink(FramedLink, asyncio.Protocol):
    """One connection, either end."""

    _transport: asyncio.Transport

    def __init__(self, max_block: int, max_pending: int, on_link: Callable[[Link], LinkHandler]) -> None:
        super().__init__("a peer", max_block)
        self._max_pending = max_pending
        self._on_link = on_link
        self._loop = asyncio.get_running_loop()
        self._waiting: list[Buffer] = []
        self._patience: asyncio.TimerHandle | None = None

    def write(self, data: Buffer) -> None:
        """Messages of one turn leave together: a system call costs more than all the rest of a hop."""
        if not self._waiting:
            self._loop.call_soon(self._flush)
        self._waiting.append(data)

    def write_now(self, data: Buffer) -> None:
        """Nothing is planned for later where nothing waits: mostly a coordinator leaves alone."""
        if self._waiting:
            self._waiting.append(data)
            self._flush()
        elif not self._transport.is_closing():
            self._transport.write(data)

    def _flush(self) -> None:
        waiting, self._waiting = self._waiting, []
        if waiting and not self._transport.is_closing():
            self._transport.write(waiting[0] if len(waiting) == 1 else b"".join(waiting))

    def close(self) -> None:
        self._flush()
        self.closed = True
        self._transport.close()
        if self._patience is None and self._transport.get_write_buffer_size():
            self._patience = self._loop.call_later(LAST_WORDS, self._transport.abort)

    def abort(self) -> None:
        self.closed = True
        self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.Transport", transport)
        self.peer = _socket_address(transport.get_extra_info("peername"))
        # A hop is one small write that nobody answers: it must not wait to be joined by more.
        if (made := transport.get_extra_info("socket")).family != socket.AF_UNIX:
            made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._transport.set_write_buffer_limits(high=self._max_pending)
        self.handler = self._on_link(self)

    def data_received(self, data: bytes) -> None:
        self.received(data)

    def pause_writing(self) -> None:
        """Asyncio's word for: more bytes wait than `max_pending`."""
        self._error = WireError(f"{self.peer} does not read: over {self._max_pending} bytes wait for it")
        self.closed = True
        self._transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        if self._patience is not None:
            self._patience.cancel()
        self.finished(AddressError(self.peer, f"the connection was lost: {exc}") if exc else None)


def _socket_address(name: str | tuple[str, int] | tuple[str, int, int, int]) -> str:
    if isinstance(name, str):
        return f"{UNIX}{name}" if name else CALLER
    return join_address(name[0], name[1])


def refusal(error: OSError | UnicodeError) -> str:
    """What a socket's error means to the user."""
    if isinstance(error, socket.gaierror | UnicodeError):
        return "the name is not known; correct it, or say where the host is with --map NAME=ADDR:PORT"
    if error.errno in _REASONS:
        return _REASONS[error.errno]
    return os.strerror(error.errno) if error.errno else str(error)

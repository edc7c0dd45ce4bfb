"""TCP and Unix-socket transport, as asyncio protocols."""

from __future__ import annotations

import asyncio
import os
import socket
import stat
import time
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.address_race import RetryPace
from lfield.errors import AddressError, NoListener
from lfield.event_loop import SimulatedLoop
from lfield.net.connections.connection_attempt import ConnectionAttempt
from lfield.net.connections.listener import PortListener, SocketListener
from lfield.net.connections.socket_errors import describe
from lfield.net.connections.tls_link import TlsLink
from lfield.net.datagrams.datagram_port import DatagramPort, DatagramReader, LinkServer, datagram_socket_at
from lfield.net.peer_credentials import socket_address
from lfield.net.scheduling.link_schedulers import LinkScheduler
from lfield.net.stream_link import StreamLink, anonymous_identity
from lfield.net.transport import UNIX, split_address, split_addresses
from lfield.text import log_messages
from lfield.text.log_messages import LogLine

if TYPE_CHECKING:
    from collections.abc import Callable

    from lfield.authority.identity import Identity
    from lfield.net.connections.resolver import ResolvedAddress
    from lfield.net.tls import TlsIdentity
    from lfield.net.transport import Link, LinkHandler, Listener

#: Connections accepted at once, and the backlog. Asyncio uses one number for both, and would accept more
#: callers at once than there are descriptors, before it can evict any.
ACCEPT_BATCH, ACCEPT_BACKLOG = 1, 128


class TcpTransport:
    """Transport over TCP or a Unix socket ("unix:PATH"), in a running loop (asyncio or uvloop).

    `max_block`: largest accepted block in bytes. `max_pending`: most bytes queued for a peer that does not
    read (default: four such blocks); above, the link is closed. `connect_timeout`: seconds to connect, and
    again for the handshake. `tls`: mutual authentication and encryption; without it peers are
    unauthenticated, except where `identify` trusts addresses (simulation). `busy`: CPU time of this thread
    for budgets; its part `exempt` is charged to no peer.
    """

    def __init__(
        self,
        max_block: int,
        tls: TlsIdentity | None = None,
        *,
        identify: Callable[[str], Identity] = anonymous_identity,
        max_pending: int | None = None,
        connect_timeout: float = 5.0,
        busy: Callable[[], float] = time.thread_time,
        exempt: Callable[[], float] = float,
    ) -> None:
        self._max_block = max_block
        self._tls, self._identify = tls, identify
        self._max_pending = 4 * max_block + (1 << 20) if max_pending is None else max_pending
        self._connect_timeout = connect_timeout
        self._scheduler = LinkScheduler(busy, exempt)
        #: Receiver of datagrams at the listening addresses; None for none.
        self.datagrams: DatagramReader | None = None
        self._busy = busy
        #: Writes a log line.
        self.note: Callable[[LogLine], None] = lambda line: None
        #: Addresses that failed lately.
        self._unanswered: set[ResolvedAddress] = set()
        self._retry_pace = RetryPace()

    def log_to(self, note: Callable[[LogLine], None]) -> None:
        """Write log lines with `note` from now on."""
        self.note = note

    async def listen(self, address: str, on_link: Callable[[Link], LinkHandler]) -> Listener:
        """Listen at every address that belongs to this computer; port 0 chooses a free port.

        "[::]" covers both families. "fd:N" is an inherited listening socket. Access to "unix:PATH" follows
        its folder: its group may connect if it may enter. Raises AddressError.
        """
        loop = asyncio.get_running_loop()
        plain = address.startswith(UNIX)

        def called() -> StreamLink:
            return self.new_link(on_link, plain=plain, calls=False)

        async def serve(listening: socket.socket) -> LinkServer:
            # A port that is in use is reported here: uvloop returns a server without a socket in this case.
            listening.listen(ACCEPT_BACKLOG)
            server = await loop.create_server(called, sock=listening, backlog=ACCEPT_BATCH)
            _set_backlog(server)
            return LinkServer(server, self._datagram_port(listening))

        try:
            if address.startswith("fd:"):
                listening = socket.socket(fileno=int(address[3:]))
                return SocketListener(await serve(listening), socket_address(listening.getsockname()))
            if plain:
                path = _path(address)
                server = await loop.create_unix_server(
                    called, sock=_bound_unix_socket(path), backlog=ACCEPT_BATCH
                )
                _set_backlog(server)
                return SocketListener(server, address, path)
            if isinstance(loop, SimulatedLoop):
                server = await loop.create_server(
                    called, *split_address(split_addresses(address)[0]), backlog=ACCEPT_BATCH
                )
                _set_backlog(server)
                return SocketListener(server, socket_address(server.sockets[0].getsockname()))
        except (OSError, UnicodeError) as error:
            raise AddressError(address, describe(error)) from None
        listener = PortListener(address, serve, lambda text: self.note(text))
        await listener.open()
        return listener

    async def connect(self, address: str, handler: LinkHandler, host: str = "") -> Link:
        """Connect to a listening host. Raises AddressError, or NoListener for a refused connection.

        Names are resolved again, and the addresses are raced; the address of another host is skipped. Raises
        HandshakeError and WireError if authentication fails.
        """
        loop = asyncio.get_running_loop()
        plain = address.startswith(UNIX)

        def calling() -> StreamLink:
            return self.new_link(lambda _: handler, plain=plain, calls=True)

        pause = self._retry_pace.on_attempt(address, loop.time())
        call = ConnectionAttempt(address, calling, self._unanswered, pause, host)
        try:
            async with asyncio.timeout(self._connect_timeout) as bound:
                if plain:
                    _, link = await loop.create_unix_connection(calling, str(_path(address)))
                    return link
                if isinstance(loop, SimulatedLoop):
                    _, link = await loop.create_connection(
                        calling, *split_address(split_addresses(address)[0])
                    )
                    return await call.adopt(link)

                def on_connected() -> None:
                    # The handshake has its full time, even if the connection was made late.
                    bound.reschedule(loop.time() + self._connect_timeout)
                    self._retry_pace.on_answer(address)

                return await call.connect(on_connected)
        except asyncio.CancelledError:
            # Otherwise the peer could complete the handshake of a link that no task owns.
            if call.link is not None:
                call.link.abort()
            raise
        except TimeoutError:
            if call.link is not None:
                call.link.abort()
            raise AddressError(
                address, call.failure_text(f"no answer within {self._connect_timeout:g} s")
            ) from None
        except (ConnectionRefusedError, FileNotFoundError) as error:
            if call.is_mixed:
                raise AddressError(address, call.failure_text(describe(error))) from None
            raise NoListener(address) from None
        except (OSError, UnicodeError) as error:
            raise AddressError(address, call.failure_text(describe(error))) from None

    def _datagram_port(self, listening: socket.socket) -> DatagramPort | None:
        """The UDP port at the address of a listening socket. Without it, stop orders arrive over
        links only.
        """
        if self.datagrams is None:
            return None
        try:
            return DatagramPort(datagram_socket_at(listening), self.datagrams, self._busy)
        except OSError as error:
            at = socket_address(listening.getsockname())
            self.note(log_messages.NO_DATAGRAMS.line(address=at, reason=describe(error)))
            return None

    def new_link(
        self, on_link: Callable[[Link], LinkHandler], *, plain: bool = False, calls: bool
    ) -> StreamLink:
        """A link without its connection: in TLS unless `plain`, dialled if `calls`."""
        block, pending, reception = self._max_block, self._max_pending, self._scheduler
        if plain or self._tls is None:
            return StreamLink(block, pending, on_link, reception, self._identify, calls=calls)
        return TlsLink(block, pending, on_link, reception, self._tls, calls=calls)


def _set_backlog(server: asyncio.Server) -> None:
    """Set the backlog in the kernel; AT_ONCE connections are accepted at a time."""
    with server.sockets[0].dup() as listening:
        listening.listen(ACCEPT_BACKLOG)


def _path(address: str) -> Path:
    path = Path(address.removeprefix(UNIX))
    if not path.is_absolute():
        raise AddressError(address, "a Unix socket is written unix:/PATH")
    return path


def _bound_unix_socket(path: Path) -> socket.socket:
    """A socket bound to a free path, for users who may enter its folder."""
    bound = socket.socket(socket.AF_UNIX)
    try:
        bound.bind(str(path))
        folder = path.parent.stat()
        for_group = folder.st_mode & stat.S_IXGRP
        if for_group and path.lstat().st_gid != folder.st_gid:
            os.chown(path, -1, folder.st_gid)
        path.chmod(0o660 if for_group else 0o600)
    except OSError:
        bound.close()
        raise
    return bound

"""A listening port at all addresses of a name, which follows the name and the interfaces of this computer."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from lfield.errors import AddressError
from lfield.loop import spawn
from lfield.net.door import socket_address
from lfield.net.paths.names import Found, looked_up
from lfield.net.paths.reasons import refusal
from lfield.net.transport import is_lasting, split_address

#: A name, or an address of an interface that may come back as another, is looked at every so many seconds.
CHECK_EVERY = 1.0


class Server(Protocol):
    """What takes the calls at a bound socket."""

    def close(self) -> None:
        """Take no more, and close the socket."""


class SocketListener:
    """One listening socket, that of a path or one that was inherited; `path` is removed at its end."""

    def __init__(self, server: Server, address: str, path: Path | None = None) -> None:
        self._server, self.address, self._path = server, address, path

    def close(self) -> None:
        """Take no more links."""
        self._server.close()
        if self._path is not None:
            with suppress(FileNotFoundError):
                self._path.unlink()


class PortListener:
    """Listens at every address of a name that is one of this computer.

    `serve` makes a server of a bound socket, `note` takes a line for the log, and `why` says what an error
    means to the user. A name that leads to other addresses later is listened at there, and no longer at the
    old ones. An attempt that fails is repeated.
    """

    def __init__(
        self,
        address: str,
        serve: Callable[[socket.socket], Awaitable[Server]],
        note: Callable[[str], None],
        why: Callable[[OSError | UnicodeError], str] = refusal,
    ) -> None:
        self._asked, self._serve, self._note, self._why = address, serve, note, why
        self._host, self._port = split_address(address)
        self._servers: dict[Found, Server] = {}
        #: The addresses of their sockets.
        self._addresses: dict[Found, str] = {}
        #: Why it does not listen at an address, as reported.
        self._failures: dict[Found, str] = {}
        self._timer: asyncio.TimerHandle | None = None
        self._is_closed = False

    async def open(self) -> None:
        """Listen, and go on following the name. Raises AddressError when it can listen at no address."""
        try:
            failures = await self._bind(await looked_up(self._host, self._port, passive=True))
        except (OSError, UnicodeError) as error:
            raise AddressError(self._asked, self._why(error)) from None
        if not self._servers:
            raise AddressError(self._asked, "; ".join(dict.fromkeys(failures.values())))
        self._report(failures)
        if not is_lasting(self._host):
            self._plan()

    @property
    def address(self) -> str:
        """Where it listens, with the real port if 0 was asked for; of several the first."""
        return self._addresses[next(iter(self._servers))]

    def close(self) -> None:
        """Take no more links."""
        self._is_closed = True
        if self._timer is not None:
            self._timer.cancel()
        for server in self._servers.values():
            server.close()

    def _plan(self) -> None:
        if not self._is_closed:
            self._timer = asyncio.get_running_loop().call_later(CHECK_EVERY, lambda: spawn(self._check()))

    async def _check(self) -> None:
        """Listen where the name leads now; without an answer stay where it led."""
        with suppress(OSError, UnicodeError):
            await self._follow(await looked_up(self._host, self._port, passive=True))
        self._plan()

    async def _follow(self, found: list[Found]) -> None:
        before = set(self._servers)
        failures = await self._bind([at for at in found if at not in self._servers])
        for at in self._servers.keys() - before:
            self._note(f"this computer listens at {self._addresses[at]}, too: {self._host} leads there now")
        self._report(failures)
        if not self._servers.keys().isdisjoint(found):
            for at in [at for at in self._servers if at not in found]:
                self._servers.pop(at).close()
                old = self._addresses.pop(at)
                self._note(f"this computer no longer listens at {old}: {self._host} leads elsewhere now")

    def _report(self, failures: dict[Found, str]) -> None:
        """Say why it does not listen at addresses, once for each reason."""
        for at, why in failures.items():
            if self._failures.get(at) != why:
                where = self._spelled(at)
                self._note(f"this computer cannot listen at {where}: {why}; trying again")
        self._failures = failures

    async def _bind(self, found: list[Found]) -> dict[Found, str]:
        """Listen at addresses; why it could not, where it could not."""
        failures: dict[Found, str] = {}
        for at in found:
            try:
                made = bound(at, self._port or self._real_port())
            except OSError as error:
                failures[at] = self._why(error)
                continue
            name = socket_address(made.getsockname())
            server = await self._serve(made)
            if self._is_closed:
                server.close()
            else:
                self._servers[at], self._addresses[at] = server, name
        return failures

    def _spelled(self, at: Found) -> str:
        return socket_address((at.address[0], self._port or self._real_port(), *at.address[2:]))

    def _real_port(self) -> int:
        """The port that was taken where any would do."""
        return split_address(self.address)[1] if self._servers else 0


def bound(at: Found, port: int) -> socket.socket:
    """A socket that is bound to an address; "::" is every address of both families. Raises OSError."""
    made = socket.socket(at.family, socket.SOCK_STREAM)
    try:
        # What is left of the links of an earlier process does not count.
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if at.family == socket.AF_INET6:
            made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, at.address[0] != "::")
        made.bind((at.address[0], port, *at.address[2:]))
        made.setblocking(False)
    except BaseException:
        made.close()
        raise
    return made

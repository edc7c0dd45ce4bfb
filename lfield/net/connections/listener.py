"""A listening port at all addresses of a name, which follows changes of the name and of the interfaces."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from lfield.errors import AddressError
from lfield.event_loop import spawn
from lfield.net.connections.resolver import AddressLookups, ResolvedAddress
from lfield.net.connections.socket_errors import describe
from lfield.net.health.tcp_options import set_listening_options
from lfield.net.peer_credentials import socket_address
from lfield.net.transport import is_lasting, split_address, split_addresses
from lfield.text import log_messages
from lfield.text.log_messages import LogLine

#: Seconds between checks of a name, or of an interface address that may change.
CHECK_EVERY = 1.0


class SocketServer(Protocol):
    """A server that accepts connections of a bound socket."""

    def close(self) -> None:
        """Stop accepting, and close the socket."""


class SocketListener:
    """One listening socket, of a path or inherited; `path` is removed at its end."""

    def __init__(self, server: SocketServer, address: str, path: Path | None = None) -> None:
        self._server, self.address, self._path = server, address, path

    def close(self) -> None:
        """Stop accepting links."""
        self._server.close()
        if self._path is not None:
            with suppress(FileNotFoundError):
                self._path.unlink()


class PortListener:
    """Listens at every address of a host that belongs to this computer.

    `serve` creates a server for a bound socket, `note` writes a log line, and `describe_error` explains an
    error to the user. When a name resolves to other addresses, the sockets follow. A failed attempt is
    repeated, and so is an address, one of several, that this computer does not have yet.
    """

    def __init__(
        self,
        address: str,
        serve: Callable[[socket.socket], Awaitable[SocketServer]],
        note: Callable[[LogLine], None],
        describe_error: Callable[[OSError | UnicodeError], str] = describe,
    ) -> None:
        self._requested, self._serve, self._note, self._describe_error = address, serve, note, describe_error
        self._parts = split_addresses(address)
        hosts = [split_address(part)[0] for part in self._parts]
        #: The requested names, for the log.
        self._host = ",".join(hosts)
        self._is_lasting = all(map(is_lasting, hosts))
        self._servers: dict[ResolvedAddress, SocketServer] = {}
        #: The sockets by address.
        self._addresses: dict[ResolvedAddress, str] = {}
        #: The logged reasons why this host does not listen at an address.
        self._failures: dict[ResolvedAddress, str] = {}
        self._timer: asyncio.TimerHandle | None = None
        self._is_closed = False

    async def open(self) -> None:
        """Listen, and follow the name. Raises AddressError when no address can be bound."""
        lookups = AddressLookups(self._parts, passive=True)
        try:
            await lookups.settle()
            failures = await self._bind(lookups.found)
        except (OSError, UnicodeError) as error:
            raise AddressError(self._requested, self._describe_error(error)) from None
        finally:
            lookups.cancel()
        if not self._servers:
            raise AddressError(self._requested, "; ".join(dict.fromkeys(failures.values())))
        self._report(failures)
        if not self._is_lasting or failures or not lookups.is_complete:
            self._plan()

    @property
    def address(self) -> str:
        """The listening addresses, with the actual port if 0 was requested; for one name only the first."""
        addresses = list(self._addresses.values())
        return addresses[0] if len(self._parts) == 1 else ",".join(addresses)

    def close(self) -> None:
        """Stop accepting links."""
        self._is_closed = True
        if self._timer is not None:
            self._timer.cancel()
        for server in self._servers.values():
            server.close()

    def _plan(self) -> None:
        if not self._is_closed:
            self._timer = asyncio.get_running_loop().call_later(CHECK_EVERY, lambda: spawn(self._check()))

    async def _check(self) -> None:
        """Listen at the present addresses of the name; keep the old ones when it does not resolve."""
        lookups = AddressLookups(self._parts, passive=True)
        try:
            with suppress(OSError, UnicodeError):
                await lookups.settle()
                await self._follow(lookups.found, is_complete=lookups.is_complete)
        finally:
            lookups.cancel()
        self._plan()

    async def _follow(self, endpoints: list[ResolvedAddress], *, is_complete: bool) -> None:
        before = set(self._servers)
        failures = await self._bind([endpoint for endpoint in endpoints if endpoint not in self._servers])
        for endpoint in self._servers.keys() - before:
            self._note(log_messages.LISTENING_ALSO.line(address=self._addresses[endpoint], host=self._host))
        self._report(failures)
        if is_complete and not self._servers.keys().isdisjoint(endpoints):
            for endpoint in [endpoint for endpoint in self._servers if endpoint not in endpoints]:
                self._servers.pop(endpoint).close()
                old = self._addresses.pop(endpoint)
                self._note(log_messages.LISTENING_ENDED.line(address=old, host=self._host))

    def _report(self, failures: dict[ResolvedAddress, str]) -> None:
        """Log the reasons for addresses that failed, once each."""
        for endpoint, reason in failures.items():
            if self._failures.get(endpoint) != reason:
                text = self._address_text(endpoint)
                self._note(log_messages.LISTENING_FAILED.line(host=self._host, address=text, reason=reason))
        self._failures = failures

    async def _bind(self, endpoints: list[ResolvedAddress]) -> dict[ResolvedAddress, str]:
        """Bind addresses. Returns the reasons of failures, by address."""
        failures: dict[ResolvedAddress, str] = {}
        for endpoint in endpoints:
            try:
                server, name = await self._listen(endpoint)
            except OSError as error:
                failures[endpoint] = self._describe_error(error)
                continue
            if self._is_closed:
                server.close()
            else:
                self._servers[endpoint], self._addresses[endpoint] = server, name
        return failures

    async def _listen(self, endpoint: ResolvedAddress) -> tuple[SocketServer, str]:
        """The server at an address, and this address with its port. Raises OSError."""
        listening = bound_socket(endpoint, endpoint.address[1] or self._real_port())
        name = socket_address(listening.getsockname())
        try:
            return await self._serve(listening), name
        except BaseException:
            # Another socket may have been bound to the same address, and may listen there now.
            listening.close()
            raise

    def _address_text(self, endpoint: ResolvedAddress) -> str:
        return socket_address(
            (endpoint.address[0], endpoint.address[1] or self._real_port(), *endpoint.address[2:])
        )

    def _real_port(self) -> int:
        """The port that the kernel chose for port 0."""
        return split_address(next(iter(self._addresses.values())))[1] if self._addresses else 0


def bound_socket(endpoint: ResolvedAddress, port: int) -> socket.socket:
    """A socket bound to an address; "::" covers both families. Raises OSError."""
    bound = socket.socket(endpoint.family, socket.SOCK_STREAM)
    try:
        # Connections of an earlier process in TIME_WAIT do not prevent binding.
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if endpoint.family == socket.AF_INET6:
            bound.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, endpoint.address[0] != "::")
        bound.bind((endpoint.address[0], port, *endpoint.address[2:]))
        bound.setblocking(False)
        set_listening_options(bound)
    except BaseException:
        bound.close()
        raise
    return bound

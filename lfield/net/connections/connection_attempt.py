"""One connection attempt to a host: resolves its names and tries its addresses until one gives a link."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING

from lfield.address_race import first_connected
from lfield.errors import AddressError, LfieldError
from lfield.net.connections.resolver import AddressLookups, ResolvedAddress
from lfield.net.connections.socket_errors import describe
from lfield.net.peer_credentials import socket_address
from lfield.net.transport import is_number, split_addresses

if TYPE_CHECKING:
    import socket

    from lfield.net.stream_link import StreamLink

#: Seconds for the authentication of an accepted connection while other addresses remain.
HANDSHAKE_TIMEOUT = 3.0


class ConnectionAttempt:
    """An attempt at `address`; `calling` creates the link of a connection.

    An address at which another host than `host` answers counts as failed while others remain. `unanswered`
    holds addresses of any host that have failed lately; they are tried last. This object updates the set. A
    silent address is tried again after `retry_pause` seconds.
    """

    def __init__(
        self,
        address: str,
        calling: Callable[[], StreamLink],
        unanswered: set[ResolvedAddress],
        retry_pause: float,
        host: str = "",
    ) -> None:
        self._addresses, self._make_link, self._unanswered = split_addresses(address), calling, unanswered
        self._retry_pause, self._host = retry_pause, host
        #: The link that is not authenticated yet.
        self.link: StreamLink | None = None
        self._remaining: list[ResolvedAddress] = []
        self._count = 0
        self._is_number = len(self._addresses) == 1 and is_number(address)
        self._failures: dict[ResolvedAddress, Exception] = {}

    async def adopt(self, link: StreamLink) -> StreamLink:
        """Authenticate the link of a connection that was made elsewhere, and return it."""
        self.link = link
        await link.ready()
        return link

    async def connect(self, on_connected: Callable[[], None] = lambda: None) -> StreamLink:
        """Connect and return a link; `on_connected` is called before each authentication.

        Raises OSError, UnicodeError, and the error of `StreamLink.ready` for the last address.
        """
        lookups = AddressLookups(self._addresses)
        try:
            await lookups.settle()
            while True:
                connection, endpoint = await self._connected(lookups)
                on_connected()
                self._remaining = [
                    other for other in self._remaining if other != endpoint and other not in self._failures
                ]
                is_last = not (self._remaining or lookups.pending)
                # At the last address, the handshake of the handler reports another host.
                self.link = await self._new_link(connection, "" if is_last else self._host)
                try:
                    async with asyncio.timeout(None if is_last else HANDSHAKE_TIMEOUT):
                        await self.link.ready()
                except (TimeoutError, LfieldError) as error:
                    self._fail(endpoint, error)
                    if is_last:
                        raise
                    continue
                self._unanswered -= {endpoint}
                self._unanswered |= self._failures.keys()
                return self.link
        finally:
            lookups.cancel()

    async def _connected(self, lookups: AddressLookups) -> tuple[socket.socket, ResolvedAddress]:
        """A connection to an address that has not failed. Raises the OSError of the last address.

        The race starts again when a look-up has a result, so that a slow name server delays no address.
        """
        while True:
            candidates = [endpoint for endpoint in lookups.found if endpoint not in self._failures]
            self._count = len(lookups.found)
            self._remaining = sorted(candidates, key=lambda endpoint: endpoint in self._unanswered)
            race = asyncio.ensure_future(
                first_connected(self._remaining, self._failures, retry_pause=self._retry_pause)
            )
            try:
                await asyncio.wait({race, *lookups.pending}, return_when=asyncio.FIRST_COMPLETED)
                if race.done() and (not race.exception() or not lookups.pending):
                    return race.result()
                if race.done():
                    await asyncio.wait(lookups.pending, return_when=asyncio.FIRST_COMPLETED)
            finally:
                race.cancel()
            await asyncio.gather(race, return_exceptions=True)

    async def _new_link(self, connection: socket.socket, host: str) -> StreamLink:
        """The link of a connection; only `host` may answer, if it is given."""

        def link() -> StreamLink:
            new_link = self._make_link()
            new_link.require_host(host)
            return new_link

        return (await asyncio.get_running_loop().create_connection(link, sock=connection))[1]

    @property
    def is_mixed(self) -> bool:
        """Whether several addresses were tried, and one of them failed for a reason other than a missing
        listener.
        """
        return not all(isinstance(error, ConnectionRefusedError) for error in self._failures.values())

    def failure_text(self, reason: str) -> str:
        """The reason of the failure, with each address that a name resolved to."""
        self._unanswered |= self._failures.keys()
        if self._is_number or not self._count:
            return reason
        parts = [
            f"{socket_address(endpoint.address)}: {_error_text(error)}"
            for endpoint, error in self._failures.items()
        ]
        remaining = [endpoint for endpoint in self._remaining if endpoint not in self._failures]
        return "; ".join(
            [*parts, *(f"{socket_address(endpoint.address)}: {reason}" for endpoint in remaining)]
        )

    def _fail(self, endpoint: ResolvedAddress, error: Exception) -> None:
        self._failures[endpoint] = error
        if self.link is not None:
            self.link.abort()
            self.link = None


def _error_text(error: Exception) -> str:
    if isinstance(error, AddressError):
        return error.reason
    if isinstance(error, TimeoutError):
        return f"no answer within {HANDSHAKE_TIMEOUT:g} s"
    return describe(error) if isinstance(error, OSError | UnicodeError) else str(error)

"""One connection attempt to a host: resolves its name and tries its addresses until one gives a link."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING

from lfield.address_race import first_connected
from lfield.errors import AddressError, LfieldError
from lfield.net.connections.resolver import ResolvedAddress, resolve
from lfield.net.connections.socket_errors import describe
from lfield.net.peer_credentials import socket_address
from lfield.net.transport import is_number, split_address

if TYPE_CHECKING:
    from lfield.net.stream_link import StreamLink

#: Seconds for the authentication of an accepted connection while other addresses remain.
HANDSHAKE_TIMEOUT = 1.5


class ConnectionAttempt:
    """An attempt at `address`; `calling` creates the link of a connection.

    `unanswered` holds addresses of any host that have failed lately; they are tried last. It is updated here.
    """

    def __init__(
        self, address: str, calling: Callable[[], StreamLink], unanswered: set[ResolvedAddress]
    ) -> None:
        self._address, self._make_link, self._unanswered = address, calling, unanswered
        #: The link that is not authenticated yet.
        self.link: StreamLink | None = None
        self._remaining: list[ResolvedAddress] = []
        self._count, self._is_number = 0, is_number(address)
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
        found = await resolve(*split_address(self._address))
        self._count = len(found)
        self._remaining = sorted(found, key=lambda at: at in self._unanswered)
        while True:
            made, at = await first_connected(self._remaining, self._failures, again=True)
            on_connected()
            self._remaining = [
                other for other in self._remaining if other != at and other not in self._failures
            ]
            _, self.link = await asyncio.get_running_loop().create_connection(self._make_link, sock=made)
            try:
                async with asyncio.timeout(HANDSHAKE_TIMEOUT if self._remaining else None):
                    await self.link.ready()
            except (TimeoutError, LfieldError) as error:
                self._fail(at, error)
                if not self._remaining:
                    raise
                continue
            self._unanswered -= {at}
            self._unanswered |= self._failures.keys()
            return self.link

    @property
    def is_mixed(self) -> bool:
        """Whether several addresses were tried, and one failed for another reason than a missing listener."""
        return not all(isinstance(error, ConnectionRefusedError) for error in self._failures.values())

    def failure_text(self, why: str) -> str:
        """The reason of the failure, with each address that a name resolved to."""
        self._unanswered |= self._failures.keys()
        if self._is_number or not self._count:
            return why
        parts = [
            f"{socket_address(at.address)}: {_error_text(error)}" for at, error in self._failures.items()
        ]
        return "; ".join([*parts, *(f"{socket_address(at.address)}: {why}" for at in self._remaining)])

    def _fail(self, at: ResolvedAddress, error: Exception) -> None:
        self._failures[at] = error
        if self.link is not None:
            self.link.abort()
            self.link = None


def _error_text(error: Exception) -> str:
    if isinstance(error, AddressError):
        return error.reason
    if isinstance(error, TimeoutError):
        return f"no answer within {HANDSHAKE_TIMEOUT:g} s"
    return describe(error) if isinstance(error, OSError | UnicodeError) else str(error)

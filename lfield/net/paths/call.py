"""One attempt to reach a host: its name is looked up, and its addresses are tried until one has a link."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING

from lfield.connecting import first_connected
from lfield.errors import AddressError, LfieldError
from lfield.net.door import socket_address
from lfield.net.paths.names import Found, looked_up
from lfield.net.paths.reasons import refusal
from lfield.net.transport import is_number, split_address

if TYPE_CHECKING:
    from lfield.net.stream import StreamLink

#: Seconds that one who has accepted a connection has to prove who it is while other addresses are left.
PROVEN_WITHIN = 1.5


class Call:
    """An attempt at `address`; `calling` makes the link of a connection.

    `unanswered` are the addresses that have failed lately, of any host: they are tried last. It is kept here.
    """

    def __init__(self, address: str, calling: Callable[[], StreamLink], unanswered: set[Found]) -> None:
        self._address, self._calling, self._unanswered = address, calling, unanswered
        #: Called when there is a connection: who is there is still to be proven.
        self.on_connected: Callable[[], None] = lambda: None
        #: The link that is not proven yet.
        self.link: StreamLink | None = None
        self._left: list[Found] = []
        self._count, self._is_number = 0, is_number(address)
        self._failures: dict[Found, Exception] = {}

    async def linked(self) -> StreamLink:
        """A link. Raises OSError and UnicodeError, and what `StreamLink.ready` raises of the last address."""
        found = await looked_up(*split_address(self._address))
        self._count = len(found)
        self._left = sorted(found, key=lambda at: at in self._unanswered)
        while True:
            made, at = await first_connected(self._left, self._failures, again=True)
            self.on_connected()
            self._left = [other for other in self._left if other != at and other not in self._failures]
            _, self.link = await asyncio.get_running_loop().create_connection(self._calling, sock=made)
            try:
                async with asyncio.timeout(PROVEN_WITHIN if self._left else None):
                    await self.link.ready()
            except (TimeoutError, LfieldError) as error:
                self._fail(at, error)
                if not self._left:
                    raise
                continue
            self._unanswered -= {at}
            self._unanswered |= self._failures.keys()
            return self.link

    @property
    def is_mixed(self) -> bool:
        """Whether several addresses were tried, and somewhere it was not for want of a listener."""
        return not all(isinstance(error, ConnectionRefusedError) for error in self._failures.values())

    def told(self, why: str) -> str:
        """Why it has failed, with each address that was tried where the host is a name."""
        self._unanswered |= self._failures.keys()
        if self._is_number or not self._count:
            return why
        parts = [f"{socket_address(at.address)}: {_in_words(error)}" for at, error in self._failures.items()]
        return "; ".join([*parts, *(f"{socket_address(at.address)}: {why}" for at in self._left)])

    def _fail(self, at: Found, error: Exception) -> None:
        self._failures[at] = error
        if self.link is not None:
            self.link.abort()
            self.link = None


def _in_words(error: Exception) -> str:
    if isinstance(error, AddressError):
        return error.reason
    if isinstance(error, TimeoutError):
        return f"no answer within {PROVEN_WITHIN:g} s"
    return refusal(error) if isinstance(error, OSError | UnicodeError) else str(error)

"""Non-blocking name resolution without a cache, since the address of a name may change.

Each lookup has its own thread. A lookup that waits for an unresponsive name server takes up to half a minute,
and would block a shared pool.
"""

from __future__ import annotations

import asyncio
import errno
import os
import socket
import threading
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

from lfield.net.transport import split_address

#: Maximum number of concurrent lookups of one name; a further look-up fails at once.
MAX_LOOKUPS = 4
#: Seconds for the look-ups of the other addresses of a host, after one has an address.
PREFERENCE_TIME = 0.25

SocketAddress = tuple[str, int] | tuple[str, int, int, int]


class ResolvedAddress(NamedTuple):
    """An address of a name, as sockets represent it."""

    family: socket.AddressFamily
    address: SocketAddress


_running: Counter[str] = Counter()


async def resolve(host: str, port: int, *, passive: bool = False) -> list[ResolvedAddress]:
    """The addresses of a name or number, in the order of the system's preference.

    `passive`: for a listening socket. Raises OSError (`socket.gaierror` for an unknown name) and
    UnicodeError.
    """
    with suppress(socket.gaierror):
        return resolve_blocking(host, port, socket.AI_NUMERICHOST, passive=passive)
    if "%" in host:
        # An address with the zone of an interface that does not exist.
        raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
    if _running[host] >= MAX_LOOKUPS:
        raise socket.gaierror(socket.EAI_AGAIN, "the name server does not answer")
    loop = asyncio.get_running_loop()
    result: asyncio.Future[list[ResolvedAddress]] = loop.create_future()

    def done(found: list[ResolvedAddress] | OSError | UnicodeError) -> None:
        _running[host] -= 1
        if not _running[host]:
            del _running[host]
        if result.done():
            return
        if isinstance(found, list):
            result.set_result(found)
        else:
            result.set_exception(found)

    def work() -> None:
        found: list[ResolvedAddress] | OSError | UnicodeError
        try:
            found = resolve_blocking(host, port, passive=passive)
        except (OSError, UnicodeError) as error:
            found = error
        # The loop may be closed now, without waiters.
        with suppress(RuntimeError):
            loop.call_soon_threadsafe(done, found)

    _running[host] += 1
    threading.Thread(target=work, name=f"lookup {host}", daemon=True).start()
    return await result


class AddressLookups:
    """Look-ups of all addresses of a host at the same time: a name without an answer delays no other address.

    Raises AddressError for an address that cannot be split.
    """

    def __init__(self, addresses: Sequence[str], *, passive: bool = False) -> None:
        endpoints = [split_address(address) for address in addresses]
        self._tasks = [asyncio.ensure_future(resolve(*each, passive=passive)) for each in endpoints]

    async def settle(self) -> None:
        """Wait for the first addresses, and a short time for the addresses that the user prefers.

        Raises OSError and UnicodeError when no look-up has an address.
        """
        while not self.found and self.pending:
            await asyncio.wait(self.pending, return_when=asyncio.FIRST_COMPLETED)
        if self.pending:
            await asyncio.wait(self.pending, timeout=PREFERENCE_TIME)
        errors = [error for task in self._tasks if task.done() and (error := task.exception())]
        if errors and not self.found:
            raise errors[0]

    @property
    def pending(self) -> list[asyncio.Task[list[ResolvedAddress]]]:
        """The look-ups without a result."""
        return [task for task in self._tasks if not task.done()]

    @property
    def found(self) -> list[ResolvedAddress]:
        """The addresses that are known, in order of preference."""
        done = [task for task in self._tasks if task.done() and not task.exception()]
        return list(dict.fromkeys(at for task in done for at in task.result()))

    @property
    def is_complete(self) -> bool:
        """Whether each look-up has addresses."""
        return all(task.done() and not task.exception() and task.result() for task in self._tasks)

    def cancel(self) -> None:
        """End the look-ups without a result."""
        for task in self._tasks:
            if not task.cancel() and not task.cancelled():
                # An error that no task has retrieved is no fault.
                task.exception()


def resolve_blocking(host: str, port: int, flags: int = 0, *, passive: bool = False) -> list[ResolvedAddress]:
    """The addresses of a name, as of `resolve`; blocks the thread."""
    flags |= socket.AI_PASSIVE if passive else 0
    rows = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=flags)
    # Without IPv6 in Python, addresses have other types, which typeshed includes.
    found = (ResolvedAddress(family, address) for family, _, _, _, address in rows)  # type: ignore[arg-type]
    return list(dict.fromkeys(found))

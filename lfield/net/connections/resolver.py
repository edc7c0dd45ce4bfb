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
from contextlib import suppress
from typing import NamedTuple

#: Maximum number of concurrent lookups of one name; a further one fails at once.
MAX_LOOKUPS = 4

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
        # The loop may be closed by now, without waiters.
        with suppress(RuntimeError):
            loop.call_soon_threadsafe(done, found)

    _running[host] += 1
    threading.Thread(target=work, name=f"lookup {host}", daemon=True).start()
    return await result


def resolve_blocking(host: str, port: int, flags: int = 0, *, passive: bool = False) -> list[ResolvedAddress]:
    """The same, blocking."""
    flags |= socket.AI_PASSIVE if passive else 0
    rows = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=flags)
    return list(dict.fromkeys(ResolvedAddress(family, address) for family, _, _, _, address in rows))  # type: ignore[arg-type]

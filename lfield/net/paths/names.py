"""Looks up names without blocking the event loop, anew each time: a name may lead elsewhere tomorrow.

Each lookup has a thread of its own. One that waits for a name server which does not answer takes up to half a
minute, and would keep lookups of other names, and later ones of the same name, from a shared pool.
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

#: So many lookups of one name may be under way; a further one waits for none of them, and fails.
MOST_LOOKUPS = 4

SocketAddress = tuple[str, int] | tuple[str, int, int, int]


class Found(NamedTuple):
    """An address of a name, as sockets have it."""

    family: socket.AddressFamily
    address: SocketAddress


_under_way: Counter[str] = Counter()


async def looked_up(host: str, port: int, *, passive: bool = False) -> list[Found]:
    """The addresses of a name or number, in the order of the system's preference.

    `passive`: for a listening socket. Raises OSError (`socket.gaierror` for a name that is not known) and
    UnicodeError.
    """
    with suppress(socket.gaierror):
        return numbers_of(host, port, socket.AI_NUMERICHOST, passive=passive)
    if "%" in host:
        # An address with a zone, which is the name of an interface that there is not.
        raise OSError(errno.ENODEV, os.strerror(errno.ENODEV))
    if _under_way[host] >= MOST_LOOKUPS:
        raise socket.gaierror(socket.EAI_AGAIN, "the name server does not answer")
    loop = asyncio.get_running_loop()
    result: asyncio.Future[list[Found]] = loop.create_future()

    def done(found: list[Found] | OSError | UnicodeError) -> None:
        _under_way[host] -= 1
        if not _under_way[host]:
            del _under_way[host]
        if result.done():
            return
        if isinstance(found, list):
            result.set_result(found)
        else:
            result.set_exception(found)

    def work() -> None:
        found: list[Found] | OSError | UnicodeError
        try:
            found = numbers_of(host, port, passive=passive)
        except (OSError, UnicodeError) as error:
            found = error
        # The loop may be closed by now: then nobody waits.
        with suppress(RuntimeError):
            loop.call_soon_threadsafe(done, found)

    _under_way[host] += 1
    threading.Thread(target=work, name=f"lookup {host}", daemon=True).start()
    return await result


def numbers_of(host: str, port: int, flags: int = 0, *, passive: bool = False) -> list[Found]:
    """The same, while the caller waits."""
    flags |= socket.AI_PASSIVE if passive else 0
    rows = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=flags)
    return list(dict.fromkeys(Found(family, address) for family, _, _, _, address in rows))  # type: ignore[arg-type]

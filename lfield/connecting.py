"""Connects to whichever address of a host answers first: one that is silent delays no other."""

from __future__ import annotations

import asyncio
import errno
import os
import socket
from collections import deque
from collections.abc import Sequence
from typing import Any, TypeVar

#: Seconds until the next address is tried beside those that have not answered (RFC 8305, section 5).
STAGGER = 0.25


#: A family and an address, as sockets have them.
Found = TypeVar("Found", bound=tuple[int, tuple[Any, ...]])


async def first_connected(
    addresses: Sequence[Found], failures: dict[Found, Exception]
) -> tuple[socket.socket, Found]:
    """A connected socket, and to which of the addresses; those that fail are put into `failures`.

    Raises the OSError of the last one when all have failed.
    """
    left, tasks = deque(addresses), dict[asyncio.Task[socket.socket], Found]()
    winner: asyncio.Task[socket.socket] | None = None
    try:
        while left or tasks:
            if left:
                found = left.popleft()
                tasks[asyncio.ensure_future(_connected(*found))] = found
            done, _ = await asyncio.wait(
                tasks, timeout=STAGGER if left else None, return_when=asyncio.FIRST_COMPLETED
            )
            for task in done:
                found, error = tasks.pop(task), task.exception()
                if error is None:
                    winner = task
                    return task.result(), found
                if not isinstance(error, OSError):
                    raise error
                failures[found] = error
        error = next(reversed(failures.values()))
        raise error
    finally:
        for task in tasks:
            task.cancel()
            task.add_done_callback(_close)
        for task in done if winner is not None else ():
            if task is not winner:
                _close(task)


async def _connected(family: int, address: tuple[Any, ...]) -> socket.socket:
    """A socket that is connected. Not by `sock_connect` of the loops: those forget the zone of an address."""
    made = socket.socket(family, socket.SOCK_STREAM)
    try:
        made.setblocking(False)
        error = made.connect_ex(address)
        if error == errno.EINPROGRESS:
            await _writable(made)
            error = made.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if error:
            raise OSError(error, os.strerror(error))
    except BaseException:
        made.close()
        raise
    return made


async def _writable(made: socket.socket) -> None:
    loop = asyncio.get_running_loop()
    done: asyncio.Future[None] = loop.create_future()

    def ready() -> None:
        if not done.done():
            done.set_result(None)

    loop.add_writer(made.fileno(), ready)
    try:
        await done
    finally:
        loop.remove_writer(made.fileno())


def _close(task: asyncio.Task[socket.socket]) -> None:
    """Close what nobody needs any more."""
    if not task.cancelled() and task.exception() is None:
        task.result().close()

"""Connects to whichever address of a host answers first: one that is silent delays no other.

A kernel repeats an unanswered attempt after 1, 2, 4 s ..., so after an outage it may be seconds until the
next. A caller that has to be there sooner makes attempts of its own, beside those that are under way.
"""

from __future__ import annotations

import asyncio
import errno
import os
import socket
from collections import deque
from collections.abc import Sequence
from typing import Any, Generic, TypeVar

#: Seconds until the next address is tried beside those that have not answered (RFC 8305, section 5).
STAGGER = 0.25


#: Seconds between two attempts at one address for whoever wants them repeated, and for how long each goes on:
#: so about five packets of 60 bytes go out a second.
AGAIN, ATTEMPT = 0.5, 2.0


#: A family and an address, as sockets have them.
Found = TypeVar("Found", bound=tuple[int, tuple[Any, ...]])


class _Race(Generic[Found]):
    """Attempts at some addresses, side by side; they go on until there is a socket or none is left.

    With `again`, each address that has not failed is tried anew every AGAIN seconds.
    """

    def __init__(self, addresses: Sequence[Found], failures: dict[Found, Exception], *, again: bool) -> None:
        self._left, self._failures, self._again = deque(addresses), failures, again
        self._tasks: dict[asyncio.Task[socket.socket], tuple[Found, float]] = {}
        self._now = asyncio.get_running_loop().time

    async def won(self) -> tuple[socket.socket, Found]:
        """See `first_connected`."""
        while self._left or self._tasks:
            if self._left:
                found = self._left.popleft()
                self._tasks[asyncio.ensure_future(_connected(*found))] = found, self._now()
            for task in await self._ended():
                found, _ = self._tasks.pop(task)
                if task.cancelled():
                    continue
                error = task.exception()
                if error is None:
                    return task.result(), found
                if not isinstance(error, OSError):
                    raise error
                self._fail(found, error)
        raise next(reversed(self._failures.values()))

    async def _ended(self) -> list[asyncio.Task[socket.socket]]:
        """The attempts that have ended when it is time for the next."""
        pause = AGAIN if self._again else None
        done, _ = await asyncio.wait(
            self._tasks, timeout=STAGGER if self._left else pause, return_when=asyncio.FIRST_COMPLETED
        )
        if not done and not self._left:
            oldest = self._now() - ATTEMPT
            for task, (_, began) in self._tasks.items():
                if began <= oldest:
                    task.cancel()
            self._left.extend(dict.fromkeys(found for found, _ in self._tasks.values()))
        return list(done)

    def _fail(self, found: Found, error: OSError) -> None:
        """An address has failed: its other attempts would as well."""
        self._failures[found] = error
        self._left = deque(other for other in self._left if other != found)
        for task, (other, _) in self._tasks.items():
            if other == found:
                task.cancel()

    def close(self) -> None:
        """Nobody needs the others any more."""
        for task in self._tasks:
            task.cancel()
            task.add_done_callback(_close)


async def first_connected(
    addresses: Sequence[Found], failures: dict[Found, Exception], *, again: bool = False
) -> tuple[socket.socket, Found]:
    """A connected socket, and to which of the addresses; those that fail are put into `failures`.

    With `again`, an address that has not answered within AGAIN seconds is tried once more beside the earlier
    attempts, until one is connected: for whoever waits for a path that may come back at any moment. Raises
    the OSError of the last address when all have failed.
    """
    race = _Race(addresses, failures, again=again)
    try:
        return await race.won()
    finally:
        race.close()


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

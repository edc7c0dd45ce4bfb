"""Connection racing (RFC 8305, "happy eyeballs"): connects to the address of a host that answers first.

The kernel repeats an unanswered attempt after 1, 2, 4 s ..., so reconnection after an outage can take
seconds. A caller that needs it sooner repeats attempts in parallel: the longer an address is silent, the less
often. After a short outage a link is restored at once. Attempts at a robot that is off use little of a slow
radio, and do not fill a path that has become slow: each attempt is two or three packets of 60 bytes.
"""

from __future__ import annotations

import asyncio
import errno
import os
import socket
from collections import deque
from collections.abc import Sequence
from typing import Any, Generic, TypeVar

#: Seconds before the next address is tried in parallel (RFC 8305, section 5).
ATTEMPT_DELAY = 0.25
#: The shortest lifetime of an attempt in seconds.
ATTEMPT_TIMEOUT = 2.0
#: Seconds between two attempts: the first and the longest interval; and the pause as a share of the silence.
FIRST_PAUSE, LONGEST_PAUSE, SHARE = 0.5, 8.0, 1 / 30
#: Seconds after an attempt after which its address counts as new, because its state is unknown.
FORGET_AFTER = 60.0

#: An address family and a socket address.
Resolved = TypeVar("Resolved", bound=tuple[int, tuple[Any, ...]])


class _Race(Generic[Resolved]):
    """Parallel attempts at several addresses, until one connects or all have failed.

    Each address that has not failed is tried again every `retry_pause` seconds, unless this is None.
    """

    def __init__(
        self,
        addresses: Sequence[Resolved],
        failures: dict[Resolved, Exception],
        retry_pause: float | None,
    ) -> None:
        self._remaining, self._failures, self._retry_pause = deque(addresses), failures, retry_pause
        self._tasks: dict[asyncio.Task[socket.socket], tuple[Resolved, float]] = {}
        self._now = asyncio.get_running_loop().time

    async def run(self) -> tuple[socket.socket, Resolved]:
        """See `first_connected`."""
        while self._remaining or self._tasks:
            if self._remaining:
                address = self._remaining.popleft()
                self._tasks[asyncio.ensure_future(_connect(*address))] = address, self._now()
            for task in await self._wait_ended():
                address, _ = self._tasks.pop(task)
                if task.cancelled():
                    continue
                error = task.exception()
                if error is None:
                    return task.result(), address
                if not isinstance(error, OSError):
                    raise error
                self._fail(address, error)
        raise next(reversed(self._failures.values()))

    async def _wait_ended(self) -> list[asyncio.Task[socket.socket]]:
        """Wait for attempts to end, at most until the next one is due."""
        done, _ = await asyncio.wait(
            self._tasks,
            timeout=ATTEMPT_DELAY if self._remaining else self._retry_pause,
            return_when=asyncio.FIRST_COMPLETED,
        )
        if not done and not self._remaining:
            oldest = self._now() - ATTEMPT_TIMEOUT
            for task, (_, started) in self._tasks.items():
                if started <= oldest:
                    task.cancel()
            self._remaining.extend(dict.fromkeys(address for address, _ in self._tasks.values()))
        return list(done)

    def _fail(self, address: Resolved, error: OSError) -> None:
        """An address failed: cancel its other attempts."""
        self._failures[address] = error
        self._remaining = deque(
            other_address for other_address in self._remaining if other_address != address
        )
        for task, (other_address, _) in self._tasks.items():
            if other_address == address:
                task.cancel()

    def close(self) -> None:
        """Cancel the remaining attempts."""
        for task in self._tasks:
            task.cancel()
            task.add_done_callback(_close)


async def first_connected(
    addresses: Sequence[Resolved],
    failures: dict[Resolved, Exception],
    *,
    retry_pause: float | None = None,
) -> tuple[socket.socket, Resolved]:
    """A connected socket and its address; failed addresses are added to `failures`.

    An address that has not answered within `retry_pause` seconds is tried again in parallel, for paths that
    may work again at any moment. Raises the OSError of the last address when all have failed.
    """
    race = _Race(addresses, failures, retry_pause)
    try:
        return await race.run()
    finally:
        race.close()


async def _connect(family: int, address: tuple[Any, ...]) -> socket.socket:
    """Connect one socket. The loop's `sock_connect` is not used, because it loses the scope id of an IPv6
    address.
    """
    connection = socket.socket(family, socket.SOCK_STREAM)
    try:
        connection.setblocking(False)
        error = connection.connect_ex(address)
        if error == errno.EINPROGRESS:
            await _writable(connection)
            error = connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if error:
            raise OSError(error, os.strerror(error))
    except BaseException:
        connection.close()
        raise
    return connection


async def _writable(connection: socket.socket) -> None:
    loop = asyncio.get_running_loop()
    done: asyncio.Future[None] = loop.create_future()

    def ready() -> None:
        if not done.done():
            done.set_result(None)

    loop.add_writer(connection.fileno(), ready)
    try:
        await done
    finally:
        loop.remove_writer(connection.fileno())


def _close(task: asyncio.Task[socket.socket]) -> None:
    """Close the sockets of cancelled attempts."""
    if not task.cancelled() and task.exception() is None:
        task.result().close()


def retry_pause(silent: float) -> float:
    """The pause after an attempt at an address that has been silent for `silent` seconds."""
    return min(LONGEST_PAUSE, max(FIRST_PAUSE, SHARE * silent))


class RetryPace:
    """The addresses of one transport that have not answered. Times are in seconds of one clock."""

    def __init__(self) -> None:
        #: The time since when each address is silent, and the time of its last attempt.
        self._silent: dict[str, tuple[float, float]] = {}

    def on_attempt(self, address: str, now: float) -> float:
        """An attempt begins. Returns the pause until its repetition."""
        since, last = self._silent.get(address, (now, now))
        if now - last > FORGET_AFTER:
            since = now
        self._silent[address] = since, now
        return retry_pause(now - since)

    def on_answer(self, address: str) -> None:
        """An address has answered."""
        self._silent.pop(address, None)

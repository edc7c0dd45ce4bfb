"""The interface of a vehicle to services: sending, and an inbox.

Services (plans, parameters, files) depend on nothing else of links and devices, so each can be tested alone.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from lfield.driver import DeviceError

#: Messages that wait to be read; more than a burst of file data on a fast link.
MAX_MESSAGES = 4096
#: Seconds between two checks of the link while nothing arrives.
LINK_CHECK_INTERVAL = 0.1


class Peer(Protocol):
    """The interface of a vehicle that a service uses."""

    #: The system id of the vehicle.
    system: int

    def send(self, message: Any, /) -> None:
        """Sends a message, which may be lost."""

    def on(self, message_id: int, handler: Callable[[Any], None], /) -> None:
        """Calls `handler` for every message of this id that is addressed to us."""

    def error(self, reason: str, *, timeout: bool = False) -> DeviceError:
        """The exception for a reason; with `timeout` for a missing answer."""

    def check_link(self) -> None:
        """Raises DeviceError when the link is lost."""


class Mail:
    """Messages in order of arrival; none is missed when several arrive at once."""

    def __init__(self, peer: Peer) -> None:
        self._peer = peer
        self._messages: asyncio.Queue[Any] = asyncio.Queue(MAX_MESSAGES)

    def put(self, message: Any) -> None:
        """Adds a message; drops it when the queue is full, since every service retries."""
        if not self._messages.full():
            self._messages.put_nowait(message)

    async def next(self, timeout: float) -> Any | None:
        """The next message; None after `timeout` seconds. Raises DeviceError."""
        return await self.find(lambda _: True, timeout)

    async def find(self, accepts: Callable[[Any], bool], timeout: float) -> Any | None:
        """The next matching message, others are dropped; None after `timeout` seconds.

        Raises DeviceError as soon as the link is lost.
        """
        now = asyncio.get_running_loop().time
        end = now() + timeout
        # A rounding error of the clock must not cause a wait.
        while (remaining := end - now()) > 1e-9:
            try:
                async with asyncio.timeout(min(remaining, LINK_CHECK_INTERVAL)):
                    message = await self._messages.get()
            except TimeoutError:
                self._peer.check_link()
                continue
            if accepts(message):
                return message
        return None


class Inbox:
    """Receives the messages of some ids: `with inbox.open() as mail: ...`."""

    def __init__(self, peer: Peer, *message_ids: int) -> None:
        self._peer = peer
        # In the order of opening, for deterministic effects.
        self._readers: list[Mail] = []
        for message_id in message_ids:
            peer.on(message_id, self._put)

    @contextmanager
    def open(self) -> Iterator[Mail]:
        """Receives messages until the end of the block."""
        mail = Mail(self._peer)
        self._readers.append(mail)
        try:
            yield mail
        finally:
            self._readers.remove(mail)

    def _put(self, message: Any) -> None:
        for mail in self._readers:
            mail.put(message)

"""One vehicle as a service sees it: somewhere to send to, and an inbox for what comes back.

The services (plans, parameters, files) know nothing of links and devices beyond this, so each can be tried
against a few scripted lines.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from lfield.driver import DeviceError

#: Messages that wait to be read; more than a burst of file data on a fast link.
KEPT = 4096
#: Seconds between two looks at the link while nothing comes.
LOOK = 0.1


class Peer(Protocol):
    """What a service needs of a vehicle."""

    #: Its system id.
    system: int

    def send(self, message: Any, /) -> None:
        """Send it a message, which may be lost."""

    def on(self, message_id: int, handler: Callable[[Any], None], /) -> None:
        """Call `handler` with every message of this id that is for us, from now on."""

    def error(self, reason: str, *, timeout: bool = False) -> DeviceError:
        """The exception to raise for that reason; with `timeout` when nobody answered."""

    def check_link(self) -> None:
        """Raise DeviceError when the vehicle is not heard any more."""


class Mail:
    """Messages in order of arrival; unlike a wait for one, it misses nothing when many come at once."""

    def __init__(self, peer: Peer) -> None:
        self._peer = peer
        self._messages: asyncio.Queue[Any] = asyncio.Queue(KEPT)

    def put(self, message: Any) -> None:
        """Keep a message. When too many wait it is lost, as on a radio; every service asks again."""
        if not self._messages.full():
            self._messages.put_nowait(message)

    async def next(self, bound: float) -> Any | None:
        """The next message; None when none came within `bound` seconds. Raises DeviceError."""
        return await self.find(lambda _: True, bound)

    async def find(self, wanted: Callable[[Any], bool], bound: float) -> Any | None:
        """The next message that is wanted, the others thrown away; None when none came in `bound` seconds.

        Raises DeviceError as soon as the link is lost.
        """
        now = asyncio.get_running_loop().time
        end = now() + bound
        # A rounding error of the clock is no time to wait for.
        while (left := end - now()) > 1e-9:
            try:
                async with asyncio.timeout(min(left, LOOK)):
                    message = await self._messages.get()
            except TimeoutError:
                self._peer.check_link()
                continue
            if wanted(message):
                return message
        return None


class Inbox:
    """The messages of some ids, for whoever reads them: `with inbox.open() as mail: ...`."""

    def __init__(self, peer: Peer, *message_ids: int) -> None:
        self._peer = peer
        # In the order of their opening, so that the same messages have the same effects each time.
        self._readers: list[Mail] = []
        for message_id in message_ids:
            peer.on(message_id, self._put)

    @contextmanager
    def open(self) -> Iterator[Mail]:
        """What comes from now on, until the end of the block."""
        mail = Mail(self._peer)
        self._readers.append(mail)
        try:
            yield mail
        finally:
            self._readers.remove(mail)

    def _put(self, message: Any) -> None:
        for mail in self._readers:
            mail.put(message)

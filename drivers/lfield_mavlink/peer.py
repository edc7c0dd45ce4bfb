"""One vehicle as a service sees it: somewhere to send to, and an inbox for what comes back.

The services (plans, parameters, files) know nothing of links and devices beyond this, so each can be tried
against a few scripted lines.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

from lfield.errors import DeviceError

#: Messages that wait to be read; more than a burst of file data on a fast link.
KEPT = 4096
#: Seconds between two looks at the link while nothing comes.
LOOK = 0.1


class MakeError(Protocol):
    """What makes the exception to raise: `lfield.driver.Device.error`."""

    def __call__(self, reason: str, *, timeout: bool = False) -> DeviceError:
        """The exception with that reason; with `timeout` when nobody answered."""


@dataclass(frozen=True, slots=True)
class Peer:
    """A vehicle: its system id, a way to send, to hear messages of one id that are for us, and to fail.

    `check_link` raises DeviceError when the vehicle is not heard any more.
    """

    system: int
    send: Callable[[Any], None]
    on: Callable[[int, Callable[[Any], None]], None]
    error: MakeError
    check_link: Callable[[], None]


class Mail:
    """Messages in order of arrival; unlike a wait for one, it misses nothing when many come at once."""

    def __init__(self, check_link: Callable[[], None]) -> None:
        self._messages: asyncio.Queue[Any] = asyncio.Queue(KEPT)
        self._check_link = check_link

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
        while (left := end - now()) > 0.0:
            try:
                async with asyncio.timeout(min(left, LOOK)):
                    message = await self._messages.get()
            except TimeoutError:
                self._check_link()
                continue
            if wanted(message):
                return message
        return None


class Inbox:
    """The messages of some ids, for whoever reads them: `with inbox.open() as mail: ...`."""

    def __init__(self, peer: Peer, *message_ids: int) -> None:
        self._check_link = peer.check_link
        self._readers: set[Mail] = set()
        for message_id in message_ids:
            peer.on(message_id, self._put)

    @contextmanager
    def open(self) -> Iterator[Mail]:
        """What comes from now on, until the end of the block."""
        mail = Mail(self._check_link)
        self._readers.add(mail)
        try:
            yield mail
        finally:
            self._readers.remove(mail)

    def _put(self, message: Any) -> None:
        for mail in self._readers:
            mail.put(message)

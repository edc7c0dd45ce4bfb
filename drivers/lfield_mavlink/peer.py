"""One vehicle as a service sees it: somewhere to send to, and an inbox for what comes back.

The services (plans, parameters, files) know nothing of links and devices beyond this, so each can be tried
against a few scripted lines.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Protocol

from lfield.errors import DeviceError

#: Messages that an inbox keeps; more than a burst of file data on a fast link.
KEPT = 4096


class MakeError(Protocol):
    """What makes the exception to raise: `lfield.driver.Device.error`."""

    def __call__(self, reason: str, *, timeout: bool = False) -> DeviceError:
        """The exception with that reason; with `timeout` when nobody answered."""


@dataclass(frozen=True, slots=True)
class Peer:
    """A vehicle: its system id, a way to send, to hear messages of one id that are for us, and to fail."""

    system: int
    send: Callable[[Any], None]
    on: Callable[[int, Callable[[Any], None]], None]
    error: MakeError


class Inbox:
    """Messages of some ids in order of arrival, kept while it is open: `with inbox: ...`.

    Unlike a wait for one message, it misses nothing when many come at once.
    """

    def __init__(self, peer: Peer, *message_ids: int) -> None:
        self._messages: asyncio.Queue[Any] = asyncio.Queue()
        self._open = False
        for message_id in message_ids:
            peer.on(message_id, self._put)

    def __enter__(self) -> Inbox:
        self._messages = asyncio.Queue(KEPT)
        self._open = True
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._open = False

    def _put(self, message: Any) -> None:
        # A full inbox loses messages as a radio does; every service asks again.
        if self._open and not self._messages.full():
            self._messages.put_nowait(message)

    async def next(self, bound: float) -> Any | None:
        """The next message; None when none came within `bound` seconds."""
        return await self.find(lambda _: True, bound)

    async def find(self, wanted: Callable[[Any], bool], bound: float) -> Any | None:
        """The next message that is wanted, the others thrown away; None when none came in `bound` seconds."""
        try:
            async with asyncio.timeout(bound):
                while True:
                    message = await self._messages.get()
                    if wanted(message):
                        return message
        except TimeoutError:
            return None

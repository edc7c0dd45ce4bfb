"""Sends a stop or pause order to one host over all paths in parallel: the first confirmation counts.

Datagrams are sent at once, and so is the order over an open link. The handshake of a new link takes 4-5 kB,
which would delay the datagrams on a slow radio: it is opened only when these paths have not answered.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection, Coroutine
from contextlib import suppress
from typing import Any

from lfield.errors import HandshakeError, LfieldError
from lfield.operator.orders.order_datagrams import OrderDatagrams
from lfield.wire.observer_messages import EmergencyStopResult

#: Seconds that an open link has before a new one is considered, and the maximum for the datagrams.
OPEN_LINK_TIME, DATAGRAM_TIME = 1.0, 4.0
#: Additional seconds for the other paths after a link has failed.
GRACE = 1.0

NewLink = Callable[[], Coroutine[Any, Any, EmergencyStopResult]]
OpenLinkAnswer = Callable[[], Awaitable[EmergencyStopResult]]


async def first_answer(
    host: str,
    new_link: NewLink,
    datagrams: OrderDatagrams | None = None,
    open_link: OpenLinkAnswer | None = None,
) -> EmergencyStopResult:
    """The answer of a host by the first path that has one. Raises the error of the link if no path has an
    answer, and HandshakeError if the host refuses.
    """
    loop = asyncio.get_running_loop()
    needed = _LinkNeeded(host, datagrams, open_link)
    link = loop.create_task(needed.over_new_link(new_link))
    tasks = {link}
    if datagrams is not None:
        tasks.add(loop.create_task(datagrams.answer(host)))
    if open_link is not None:
        tasks.add(loop.create_task(needed.over_open_link(open_link)))
    try:
        return await _first(tasks, link, lambda: datagrams.partial(host) if datagrams else None)
    finally:
        if datagrams is not None:
            datagrams.finish(host)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _first(
    tasks: Collection[asyncio.Task[EmergencyStopResult]],
    link: asyncio.Task[EmergencyStopResult],
    partial: Callable[[], LfieldError | None],
) -> EmergencyStopResult:
    """The first result. After the link has failed, the other paths have a little more time."""
    waiting, loop = set(tasks), asyncio.get_running_loop()
    failed: BaseException | None = None
    until: float | None = None
    while waiting:
        remaining = None if until is None else until - loop.time()
        done, waiting = await asyncio.wait(waiting, timeout=remaining, return_when=asyncio.FIRST_COMPLETED)
        if not done:
            break
        for task in sorted(done, key=lambda task: task is link):
            error = task.exception()
            if error is None:
                return task.result()
            if not isinstance(error, LfieldError) or (task is not link and isinstance(error, HandshakeError)):
                raise error
            if task is link:
                failed, until = error, loop.time() + GRACE
    assert failed is not None, "a link ends with an answer or an error"
    raise partial() or failed


class _LinkNeeded:
    """Opens a new link when the other paths have not answered."""

    def __init__(self, host: str, datagrams: OrderDatagrams | None, open_link: OpenLinkAnswer | None) -> None:
        self._host, self._datagrams = host, datagrams
        self._open_link_lost = asyncio.Event()
        self._has_open_link = open_link is not None

    async def over_open_link(self, open_link: OpenLinkAnswer) -> EmergencyStopResult:
        """Send over the open link; if that fails, a new one is opened at once."""
        try:
            return await open_link()
        except LfieldError:
            self._open_link_lost.set()
            raise

    async def over_new_link(self, new_link: NewLink) -> EmergencyStopResult:
        if self._has_open_link:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._open_link_lost.wait(), OPEN_LINK_TIME)
        if self._datagrams is not None:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._datagrams.wait_link_needed(self._host), DATAGRAM_TIME)
        return await new_link()

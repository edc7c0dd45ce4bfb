"""An order to one host by every way there is: whichever confirms first counts.

Datagrams are under way from the start, as is the order over a connection that stands. A new connection takes
4-5 kB for its handshake, which would delay the datagrams on a slow radio: it is begun only when these ways
have not answered.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection, Coroutine
from contextlib import suppress
from typing import Any

from lfield.errors import GreetingError, LfieldError
from lfield.operator.orders.datagrams import Datagrams
from lfield.wire.observing import EmergencyStopped

#: For so many seconds a connection that stands has the order before a new one is thought of, and as long at
#: most the datagrams.
STANDING_FOR, DATAGRAMS_FOR = 1.0, 4.0
#: After a connection has failed, the other ways have so many seconds more.
GRACE = 1.0

NewLink = Callable[[], Coroutine[Any, Any, EmergencyStopped]]
Standing = Callable[[], Awaitable[EmergencyStopped]]


async def first_answer(
    host: str, new_link: NewLink, datagrams: Datagrams | None = None, standing: Standing | None = None
) -> EmergencyStopped:
    """What a host has answered by the way that was first. Raises what the connection has raised where no way
    has an answer, and GreetingError where the host refuses."""
    loop = asyncio.get_running_loop()
    needed = _Needed(host, datagrams, standing)
    link = loop.create_task(needed.by(new_link))
    tasks = {link}
    if datagrams is not None:
        tasks.add(loop.create_task(datagrams.answer(host)))
    if standing is not None:
        tasks.add(loop.create_task(needed.unless(standing)))
    try:
        return await _first(tasks, link, lambda: datagrams.partial(host) if datagrams else None)
    finally:
        if datagrams is not None:
            datagrams.ended(host)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _first(
    tasks: Collection[asyncio.Task[EmergencyStopped]],
    link: asyncio.Task[EmergencyStopped],
    partial: Callable[[], LfieldError | None],
) -> EmergencyStopped:
    """The first result. After the link has failed, the other ways have a little more time."""
    waiting, loop = set(tasks), asyncio.get_running_loop()
    failed: BaseException | None = None
    until: float | None = None
    while waiting:
        left = None if until is None else until - loop.time()
        done, waiting = await asyncio.wait(waiting, timeout=left, return_when=asyncio.FIRST_COMPLETED)
        if not done:
            break
        for task in sorted(done, key=lambda task: task is link):
            error = task.exception()
            if error is None:
                return task.result()
            if not isinstance(error, LfieldError) or (task is not link and isinstance(error, GreetingError)):
                raise error
            if task is link:
                failed, until = error, loop.time() + GRACE
    assert failed is not None, "a link ends with an answer or an error"
    raise partial() or failed


class _Needed:
    """When a new connection is needed, since the other ways have not answered."""

    def __init__(self, host: str, datagrams: Datagrams | None, standing: Standing | None) -> None:
        self._host, self._datagrams = host, datagrams
        self._lost = asyncio.Event()
        self._stands = standing is not None

    async def unless(self, standing: Standing) -> EmergencyStopped:
        """Over the connection that stands; a new one is needed at once where it fails."""
        try:
            return await standing()
        except LfieldError:
            self._lost.set()
            raise

    async def by(self, new_link: NewLink) -> EmergencyStopped:
        """Over a new one."""
        if self._stands:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._lost.wait(), STANDING_FOR)
        if self._datagrams is not None:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._datagrams.needs_link(self._host), DATAGRAMS_FOR)
        return await new_link()

"""Waiting for what a device reports, and doing something again and again, SYNC too; on the loop."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from lfield.driver import Clock
from lfield_can.bus.frames import Frame


class News:
    """Wakes whoever waits for a condition. Any number may wait at once."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._event = asyncio.Event()

    def tell(self) -> None:
        """Something has changed."""
        self._event.set()
        self._event = asyncio.Event()

    async def next(self, longest: float) -> None:
        """Sleep until the next news, at most `longest` seconds."""
        event = self._event
        try:
            async with asyncio.timeout(longest):
                await event.wait()
        except TimeoutError:
            pass

    async def seen(self, condition: Callable[[], bool], bound: float) -> bool:
        """Whether the condition came true within `bound` seconds."""
        end = self._clock.monotonic() + bound
        while not condition():
            left = end - self._clock.monotonic()
            if left <= 0.0:
                return False
            await self.next(left)
        return True


class Repeating:
    """At most one repetition at a time."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._task: asyncio.Task[None] | None = None
        self._period, self._work = 0.0, _nothing

    def start(self, period: float, work: Callable[[], None], *, lasts: float = math.inf) -> None:
        """Do `work` every `period` seconds, for `lasts` seconds from now; whatever was repeated ends."""
        self._period, self._work = period, work
        self.again(lasts=lasts)

    def again(self, *, lasts: float = math.inf) -> None:
        """Take up what was started last."""
        self.stop()
        work = self._repeat(self._clock.monotonic() + lasts)
        self._task = asyncio.get_running_loop().create_task(work)

    def stop(self) -> None:
        """Do it no more."""
        if self._task is not None:
            self._task.cancel()
            self._task = None

    async def _repeat(self, end: float) -> None:
        due = self._clock.monotonic()
        while True:
            # What was missed is not made up for.
            now = self._clock.monotonic()
            due = max(due + self._period, now)
            await asyncio.sleep(due - now)
            if self._clock.monotonic() >= end:
                return
            self._work()


class Sync:
    """The SYNC of a bus (CiA 301, 7.2.5), every `period` seconds while a node needs it.

    There is one for all: two producers on one bus would have every node answer twice.
    """

    def __init__(self, clock: Clock, post: Callable[[Frame], None], period: float) -> None:
        self._post, self._period = post, period
        self._wanted: dict[int, int] = {}
        self._repeating = Repeating(clock)

    def want(self, node: int, identifier: int) -> None:
        """A node needs it, by the id of its object 0x1005."""
        idle = not self._wanted
        self._wanted[node] = identifier
        if idle:
            self._repeating.start(self._period, self._send)

    def leave(self, node: int) -> None:
        """It needs it no more, or shall not have it while the bus is quiet."""
        self._wanted.pop(node, None)
        if not self._wanted:
            self._repeating.stop()

    def _send(self) -> None:
        for identifier in set(self._wanted.values()):
            self._post(Frame(identifier))


def _nothing() -> None:
    """Before anything was started."""

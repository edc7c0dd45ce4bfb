"""Something that is done again and again on the loop: heartbeats, and streams that end by themselves."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from lfield.clock import Clock


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


def _nothing() -> None:
    """Before anything was started."""

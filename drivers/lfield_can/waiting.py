"""Waiting for what a device reports: conditions that are looked at with every piece of news."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from lfield.clock import Clock


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

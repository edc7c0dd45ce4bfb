"""An asyncio loop on virtual time: skips every wait, so that minutes take milliseconds, deterministically."""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Coroutine
from typing import Any, TypeVar

T = TypeVar("T")


class _JumpSelector(selectors.DefaultSelector):
    """A selector that never waits: time advances to the next timer."""

    now = 1000.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready = super().select(0)
        if ready:
            return ready
        if timeout is None:
            raise RuntimeError("the loop would sleep for ever")
        self.now += timeout
        return ready


class JumpingLoop(asyncio.SelectorEventLoop):
    """An event loop on virtual time. Code in it must not wait for other processes or threads."""

    def __init__(self) -> None:
        self._jumps = _JumpSelector()
        super().__init__(self._jumps)

    def time(self) -> float:
        """The virtual time in seconds."""
        return self._jumps.now


class LoopClock:
    """The clock of the running loop, for injection."""

    def monotonic(self) -> float:
        """The loop's time in seconds."""
        return asyncio.get_running_loop().time()

    def time(self) -> float:
        """The same time: a wall clock that began with the loop."""
        return self.monotonic()


def run_jumping(story: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine and its background tasks to completion, on virtual time."""
    with asyncio.Runner(loop_factory=JumpingLoop) as runner:
        return runner.run(story)

"""Waiting for state changes, progress of a move, periodic tasks, and SYNC; on the loop."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from lfield.driver import Clock
from lfield_can.bus.frames import Frame


class ChangeNotifier:
    """Wakes all tasks that wait for a condition."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._event = asyncio.Event()

    def notify(self) -> None:
        """Wakes the waiting tasks after a change."""
        self._event.set()
        self._event = asyncio.Event()

    async def wait_change(self, longest: float) -> None:
        """Waits for the next change, at most `longest` seconds."""
        event = self._event
        try:
            async with asyncio.timeout(longest):
                await event.wait()
        except TimeoutError:
            pass

    async def wait_for(self, condition: Callable[[], bool], bound: float) -> bool:
        """Whether the condition became true within `bound` seconds."""
        end = self._clock.monotonic() + bound
        while not condition():
            left = end - self._clock.monotonic()
            if left <= 0.0:
                return False
            await self.wait_change(left)
        return True


class MoveProgress:
    """Decides when a move has failed: its distance has not decreased by `least` rad for `limit` seconds."""

    def __init__(self, clock: Clock, limit: float, least: float) -> None:
        self._clock = clock
        self._limit, self._least = limit, least
        self._best, self._best_at = math.inf, clock.monotonic()

    def failure(self, distance: float) -> str:
        """The reason why the move has failed, or "". `distance` to the goal is in rad, inf if unknown."""
        now = self._clock.monotonic()
        if distance < self._best - self._least:
            self._best, self._best_at = distance, now
        if now - self._best_at <= self._limit:
            return ""
        return f"moveTo failed: no progress for {self._limit:g} s, {distance:.3f} rad from its goal"


class PeriodicTask:
    """At most one repetition at a time. `overruns` counts the missed ones."""

    def __init__(self, clock: Clock) -> None:
        self.overruns = 0
        self._clock = clock
        self._task: asyncio.Task[None] | None = None
        self._period, self._work = 0.0, _nothing

    def start(self, period: float, work: Callable[[], None], *, lasts: float = math.inf) -> None:
        """Calls `work` every `period` seconds, for `lasts` seconds; ends the previous repetition."""
        self._period, self._work = period, work
        self.resume(lasts=lasts)

    def resume(self, *, lasts: float = math.inf) -> None:
        """Restarts the last repetition."""
        self.stop()
        work = self._repeat(self._clock.monotonic() + lasts)
        self._task = asyncio.get_running_loop().create_task(work)

    def stop(self) -> None:
        if self._task is not None:
            self._task.cancel()
            self._task = None

    async def _repeat(self, end: float) -> None:
        due = self._clock.monotonic()
        while True:
            due += self._period
            await asyncio.sleep(due - self._clock.monotonic())
            now = self._clock.monotonic()
            if now >= end:
                return
            # Missed repetitions are skipped, and the grid of periods is kept.
            missed = max(0, int((now - due) / self._period))
            self.overruns += missed
            due += missed * self._period
            self._work()


class Sync:
    """The SYNC of a bus (CiA 301, 7.2.5), every `period` seconds while a node needs it.

    One for all nodes: two producers would cause every node to answer twice.
    """

    def __init__(self, clock: Clock, post: Callable[[Frame], None], period: float) -> None:
        self._post, self._period = post, period
        self._needed_by: dict[int, int] = {}
        self._repeating = PeriodicTask(clock)

    def require(self, node: int, identifier: int) -> None:
        """Starts SYNC for a node, with the id of its object 0x1005."""
        idle = not self._needed_by
        self._needed_by[node] = identifier
        if idle:
            self._repeating.start(self._period, self._send)

    def release(self, node: int) -> None:
        """Ends SYNC for a node that does not need it, or while the bus is muted."""
        self._needed_by.pop(node, None)
        if not self._needed_by:
            self._repeating.stop()

    def _send(self) -> None:
        for identifier in set(self._needed_by.values()):
            self._post(Frame(identifier))


def _nothing() -> None:
    """Placeholder before the first start."""

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

    async def wait_for(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Whether the condition became true within `timeout` seconds."""
        end = self._clock.monotonic() + timeout
        while not condition():
            remaining = end - self._clock.monotonic()
            if remaining <= 0.0:
                return False
            await self.wait_change(remaining)
        return True


class MoveProgress:
    """Detects a failed move: its distance has not decreased by `min_progress` rad for `limit` seconds."""

    def __init__(self, clock: Clock, limit: float, min_progress: float) -> None:
        self._clock = clock
        self._limit, self._min_progress = limit, min_progress
        self._least_distance, self._progress_at = math.inf, clock.monotonic()

    def failure(self, distance: float) -> str:
        """The reason why the move has failed, or "". `distance` to the goal is in rad, inf if unknown."""
        now = self._clock.monotonic()
        if distance < self._least_distance - self._min_progress:
            self._least_distance, self._progress_at = distance, now
        if now - self._progress_at <= self._limit:
            return ""
        return f"moveTo failed: no progress for {self._limit:g} s, {distance:.3f} rad from its goal"


class PeriodicTask:
    """Calls a function periodically. `overruns` counts the missed calls."""

    def __init__(self, clock: Clock) -> None:
        self.overruns = 0
        self._clock = clock
        self._task: asyncio.Task[None] | None = None
        self._period, self._action = 0.0, _nothing

    def start(self, period: float, action: Callable[[], None], *, duration: float = math.inf) -> None:
        """Calls `action` every `period` seconds, for `duration` seconds; ends the previous repetition."""
        self._period, self._action = period, action
        self.resume(duration=duration)

    def resume(self, *, duration: float = math.inf) -> None:
        """Restarts the last repetition."""
        self.stop()
        repetition = self._repeat(self._clock.monotonic() + duration)
        self._task = asyncio.get_running_loop().create_task(repetition)

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
            self._action()


class Sync:
    """The SYNC of a bus (CiA 301, 7.2.5), every `period` seconds while a node needs it.

    One for all nodes: two producers would cause every node to answer twice.
    """

    def __init__(self, clock: Clock, post: Callable[[Frame], None], period: float) -> None:
        self._post, self._period = post, period
        self._needed_by: dict[int, int] = {}
        self._repetition = PeriodicTask(clock)

    def require(self, node: int, identifier: int) -> None:
        """Starts SYNC for a node, with the id of its object 0x1005."""
        was_idle = not self._needed_by
        self._needed_by[node] = identifier
        if was_idle:
            self._repetition.start(self._period, self._send)

    def release(self, node: int) -> None:
        """Ends SYNC for a node that does not need it, or while the bus is muted."""
        self._needed_by.pop(node, None)
        if not self._needed_by:
            self._repetition.stop()

    def _send(self) -> None:
        for identifier in set(self._needed_by.values()):
            self._post(Frame(identifier))


def _nothing() -> None:
    """Placeholder before the first start."""

"""What happens next, in all computers of a simulation: one queue, in the order of time and then of asking."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable


class Endless(AssertionError):
    """More happens than may, and time hardly goes on."""


class Planned:
    """Something that will happen, unless it is called off."""

    __slots__ = ("event",)

    def __init__(self, event: Callable[[], None]) -> None:
        self.event: Callable[[], None] | None = event

    def call_off(self) -> None:
        """It will not happen."""
        self.event = None


class Timeline:
    """True time, in seconds since the simulation began; nobody in it can read it but through a clock."""

    def __init__(self) -> None:
        self.now = 0.0
        #: How many things have happened, and how many may.
        self.events, self.most = 0, math.inf
        self._queue: list[tuple[float, int, Planned]] = []
        self._asked = 0
        self._paused = False

    def at(self, when: float, event: Callable[[], None]) -> Planned:
        """Let something happen at a time, now if that is past."""
        self._asked += 1
        planned = Planned(event)
        heapq.heappush(self._queue, (max(when, self.now), self._asked, planned))
        return planned

    def after(self, seconds: float, event: Callable[[], None]) -> Planned:
        """Let something happen so much later."""
        return self.at(self.now + seconds, event)

    def run(self, seconds: float, watch: Callable[[], None] = lambda: None) -> None:
        """Let time go on for so long. `watch` is called after each event. Raises Endless."""
        end, self._paused = self.now + seconds, False
        while self._queue and self._queue[0][0] <= end:
            self.now, _, planned = heapq.heappop(self._queue)
            if planned.event is not None:
                if self.events >= self.most:
                    raise Endless(f"{self.events:,} events, and it goes on at {self.now:.6f} s")
                self.events += 1
                planned.event()
                watch()
                if self._paused:
                    return
        self.now = end

    def pause(self) -> None:
        """Let `run` return now, at this moment, when what happens is over."""
        self._paused = True

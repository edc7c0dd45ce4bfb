"""The event queue of a simulation: one for all computers, ordered by time and then by insertion."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable


class TooManyEvents(AssertionError):
    """Too many events at almost the same time."""


class PlannedEvent:
    """A scheduled event, which can be cancelled."""

    __slots__ = ("event",)

    def __init__(self, event: Callable[[], None]) -> None:
        self.event: Callable[[], None] | None = event

    def cancel(self) -> None:
        self.event = None


class EventQueue:
    """True time, in seconds since the start of the simulation; processes read it only through a clock."""

    def __init__(self) -> None:
        self.now = 0.0
        #: Number of events, and its limit.
        self.events, self.max_events = 0, math.inf
        self._queue: list[tuple[float, int, PlannedEvent]] = []
        self._submitted = 0
        self._paused = False

    def at(self, when: float, event: Callable[[], None]) -> PlannedEvent:
        """Schedules an event at a time, now if that is past."""
        self._submitted += 1
        planned = PlannedEvent(event)
        heapq.heappush(self._queue, (max(when, self.now), self._submitted, planned))
        return planned

    def after(self, seconds: float, event: Callable[[], None]) -> PlannedEvent:
        """Schedules an event after a delay."""
        return self.at(self.now + seconds, event)

    def run(self, seconds: float, watch: Callable[[], None] = lambda: None) -> None:
        """Advances time. `watch` is called after each event. Raises TooManyEvents."""
        end, self._paused = self.now + seconds, False
        while self._queue and self._queue[0][0] <= end:
            self.now, _, planned = heapq.heappop(self._queue)
            if planned.event is not None:
                if self.events >= self.max_events:
                    raise TooManyEvents(f"{self.events:,} events, but time is still {self.now:.6f} s")
                self.events += 1
                planned.event()
                watch()
                if self._paused:
                    return
        self.now = end

    def pause(self) -> None:
        """Makes `run` return at this time, after the present event."""
        self._paused = True

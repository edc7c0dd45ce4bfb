"""Clocks that are constant during a turn of a core: the clock of a running core, and the clock of its
replay.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from functools import partial
from operator import getitem
from typing import cast

from lfield.clock import Clock


class TurnClock:
    """The time at which the present turn began: a core reads it several times, and a replay needs it once."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._times = [clock.monotonic()]
        #: Monotonic seconds. It is no method of this class, for speed: a core reads the time a dozen times in
        #: a hop.
        self.monotonic: Callable[[], float] = cast("Callable[[], float]", partial(getitem, self._times, 0))

    def latch(self) -> float:
        """Reads the time for the next turn, and returns it."""
        self._times[0] = now = self._clock.monotonic()
        return now

    def time(self) -> float:
        """The present wall-clock seconds since 1970."""
        return self._clock.time()


class ReplayClock:
    """The recorded times of a turn; the wall-clock time is kept if none was recorded."""

    def __init__(self, at: float = 0.0, wall: float = 0.0) -> None:
        self.at, self.wall = at, wall
        #: Monotonic seconds. It is one object, as in `TurnClock`, because a checkpoint refers to it.
        self.monotonic: Callable[[], float] = self._monotonic

    def set(self, at: float, wall: float | None = None) -> None:
        """Sets the times of the next turn."""
        self.at = at
        if wall is not None:
            self.wall = wall

    def _monotonic(self) -> float:
        return self.at

    def time(self) -> float:
        """Wall-clock seconds since 1970."""
        return self.wall


class ReplayedTimes:
    """Real times as they were read within turns; without a recorded time, the time of the turn."""

    def __init__(self, clock: ReplayClock) -> None:
        self._clock = clock
        self._times: deque[float] = deque()

    def set(self, times: Iterable[float]) -> None:
        """Set the times of the next turn."""
        self._times = deque(times)

    def __call__(self) -> float:
        # Another program may read more times.
        return self._times.popleft() if self._times else self._clock.monotonic()

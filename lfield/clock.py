"""Time as a parameter: nothing in lfield reads a clock it was not given."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """What the runtime and the drivers know of time, in seconds."""

    def monotonic(self) -> float:
        """Seconds on a clock that never goes back; only differences mean anything. Suspended ones count."""

    def time(self) -> float:
        """Seconds since 1970-01-01 UTC, as the wall clock has it."""


class SystemClock:
    """The machine's own clocks."""

    def monotonic(self) -> float:
        """Seconds since the computer was started, those in which it was suspended included."""
        return time.clock_gettime(time.CLOCK_BOOTTIME)

    def time(self) -> float:
        """`time.time()`."""
        return time.time()


class ManualClock:
    """A clock that stands still until it is told to move: for tests and simulations."""

    def __init__(self, start: float = 1000.0) -> None:
        self.now = start

    def monotonic(self) -> float:
        """The time that was set."""
        return self.now

    def time(self) -> float:
        """The time that was set."""
        return self.now

    def advance(self, seconds: float) -> None:
        """Move on; `seconds` must not be negative."""
        if seconds < 0:
            raise ValueError("a clock does not go back")
        self.now += seconds

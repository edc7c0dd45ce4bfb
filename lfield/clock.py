"""Injected clocks: lfield reads time only through a `Clock` parameter."""

from __future__ import annotations

import time
from functools import partial
from typing import Protocol


class Clock(Protocol):
    """A source of monotonic and wall-clock time, in seconds."""

    def monotonic(self) -> float:
        """Monotonic seconds from an arbitrary origin, suspended time included."""

    def time(self) -> float:
        """Wall-clock seconds since 1970-01-01 UTC."""


class SystemClock:
    """The clocks of the operating system."""

    #: Seconds since boot, suspended time included.
    monotonic = staticmethod(partial(time.clock_gettime, time.CLOCK_BOOTTIME))
    time = staticmethod(time.time)


class ManualClock:
    """A clock that is set by its owner, for tests and simulations."""

    def __init__(self, start: float = 1000.0) -> None:
        self.now = start

    def monotonic(self) -> float:
        """The monotonic time that was set."""
        return self.now

    def time(self) -> float:
        """The wall-clock time that was set."""
        return self.now

    def advance(self, seconds: float) -> None:
        """Advance by `seconds`, which must not be negative."""
        if seconds < 0:
            raise ValueError("a clock does not go back")
        self.now += seconds

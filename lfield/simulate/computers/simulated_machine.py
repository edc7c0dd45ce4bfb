"""Simulated machines, each on or off with its own clock, and the network paths between them.

Each direction between two machines is a path of its own, which may be slow, or silent for a while.
"""

from __future__ import annotations

import asyncio
import random
from typing import Any

from lfield.simulate.computers.event_queue import EventQueue

#: Default minimum and maximum latency in seconds.
LATENCY = (0.001, 0.02)

#: From one machine to another, by name.
NetworkPath = tuple[str, str]


class MachineClock:
    """The clocks of one machine in seconds: arbitrary start, fast or slow."""

    def __init__(self, timeline: EventQueue, *, start: float = 0.0, rate: float = 1.0) -> None:
        self._timeline, self.rate = timeline, rate
        self._start, self._since = start, timeline.now
        self._suspended, self._wakes = 0.0, timeline.now
        #: Difference of the time of day and the uptime.
        self.ahead = 0.0

    def awake(self) -> float:
        """Uptime without suspension."""
        return self._start + (self._timeline.now - self._since) * self.rate

    def monotonic(self) -> float:
        """Uptime with suspension: boot time."""
        return self.awake() + self._suspended

    def time(self) -> float:
        """The time of day of the machine."""
        return self.monotonic() + self.ahead

    def run_at(self, rate: float) -> None:
        """Sets the rate from now on. Waiting loops must recompute their wait."""
        self._start, self._since, self.rate = self.awake(), self._timeline.now, rate

    def suspend(self, seconds: float) -> None:
        """Suspends the machine from now on: processes and timers stand still."""
        self._wakes = self._timeline.now + seconds
        self._start -= seconds * self.rate
        self._suspended += seconds * self.rate

    @property
    def suspended(self) -> bool:
        return self._timeline.now < self._wakes

    def true(self, awake: float) -> float:
        """The true time at which the machine will have been awake for so long."""
        return self._since + (awake - self._start) / self.rate


class SimulatedMachine:
    """A machine by its name. `rng` is its own, so that machines do not influence each other."""

    def __init__(self, name: str, timeline: EventQueue, rng: random.Random, rate: float = 1.0) -> None:
        self.name, self.timeline, self.rng, self.rate = name, timeline, rng, rate
        #: The initial time of day, minimum and maximum; None for any.
        self.day: tuple[float, float] | None = None
        #: Connected devices, by endpoint.
        self.hardware: dict[str, object] = {}
        #: Unfinished tasks of the machine's processes, including dead ones.
        self.pinned: set[asyncio.Task[Any]] = set()
        self.is_on = False
        self.switch_on()

    def switch_on(self) -> None:
        """Switches the machine on: its monotonic clock restarts; its time of day is arbitrary, or that of
        `set_day`.
        """
        self.is_on = True
        self.clock = MachineClock(self.timeline, start=self.rng.uniform(1.0, 1e5), rate=self.rate)
        self.clock.ahead = self.rng.uniform(0.0, 2e9)
        if self.day is not None:
            self.set_day(self.day)

    def switch_off(self) -> None:
        """Switches the machine off: no process runs on it."""
        self.is_on = False

    def set_day(self, day: tuple[float, float]) -> None:
        """From now on the machine knows the time of day approximately, also after it was switched off."""
        self.day = day
        self.set_time(self.rng.uniform(*day) + self.timeline.now)

    def set_time(self, seconds: float) -> None:
        """Sets the time of day, in seconds since 1970, until the machine is switched off."""
        self.clock.ahead = seconds - self.clock.monotonic()


class NetworkPaths:
    """The state of the paths. `slow` has latencies in seconds, minimum and maximum."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self.silent: set[NetworkPath] = set()
        #: Machines on a cable, as hardware is.
        self.cabled: set[str] = set()
        self.slow: dict[NetworkPath, tuple[float, float]] = {}

    def delay(self, path: NetworkPath) -> float:
        """The delay of a path in seconds; almost none within a machine or on a cable."""
        if path[0] == path[1] or not self.cabled.isdisjoint(path):
            return 0.0001
        return self._rng.uniform(*self.slow.get(path, LATENCY))

    def silences(self, host: str, other: str) -> bool:
        """Whether either direction is silent."""
        return (host, other) in self.silent or (other, host) in self.silent

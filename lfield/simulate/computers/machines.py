"""Simulated machines, each switched on or off and with a clock of its own, and the ways between them.

Of each pair of machines each direction is a way of its own, which may be slow, or silent for a while.
"""

from __future__ import annotations

import asyncio
import random
from typing import Any

from lfield.simulate.computers.timeline import Timeline

#: Seconds that bytes take at least and at most, where nothing else is said.
LATENCY = (0.001, 0.02)

#: From one machine to another, by their names.
Way = tuple[str, str]


class MachineClock:
    """The clocks of one machine in seconds: they begin anywhere, and run fast or slow."""

    def __init__(self, timeline: Timeline, *, began: float = 0.0, rate: float = 1.0) -> None:
        self._timeline, self.rate = timeline, rate
        self._began, self._since = began, timeline.now
        self._suspended, self._wakes = 0.0, timeline.now
        #: How far the time of day is ahead of the time since it was switched on.
        self.ahead = 0.0

    def awake(self) -> float:
        """Since it was switched on, more or less, without the time in which it was suspended."""
        return self._began + (self._timeline.now - self._since) * self.rate

    def monotonic(self) -> float:
        """The same, and that time with it: boot time."""
        return self.awake() + self._suspended

    def time(self) -> float:
        """What it takes for the time of day."""
        return self.monotonic() + self.ahead

    def run_at(self, rate: float) -> None:
        """Run so fast from now on. Who waits for it must look again."""
        self._began, self._since, self.rate = self.awake(), self._timeline.now, rate

    def stands_still(self, seconds: float) -> None:
        """The machine is suspended for so long from now on: nobody on it runs, and timers stand still."""
        self._wakes = self._timeline.now + seconds
        self._began -= seconds * self.rate
        self._suspended += seconds * self.rate

    @property
    def suspended(self) -> bool:
        """Whether it stands still now."""
        return self._timeline.now < self._wakes

    def true(self, awake: float) -> float:
        """When it will have been awake for so long, in true time."""
        return self._since + (awake - self._began) / self.rate


class Machine:
    """A machine by its name. `dice` are its own, so that what happens on one changes nothing on another."""

    def __init__(self, name: str, timeline: Timeline, dice: random.Random, rate: float = 1.0) -> None:
        self.name, self.timeline, self.dice, self.rate = name, timeline, dice, rate
        #: What its time of day was when the simulation began, at least and at most; None for anything.
        self.day: tuple[float, float] | None = None
        #: What is plugged in, by endpoint.
        self.hardware: dict[str, object] = {}
        #: The tasks of its processes that have not ended, those of dead processes too.
        self.pinned: set[asyncio.Task[Any]] = set()
        self.on = False
        self.switch_on()

    def switch_on(self) -> None:
        """Its monotonic clock begins anew; its time of day is anything, or what it was told."""
        self.on = True
        self.clock = MachineClock(self.timeline, began=self.dice.uniform(1.0, 1e5), rate=self.rate)
        self.clock.ahead = self.dice.uniform(0.0, 2e9)
        if self.day is not None:
            self.set_day(self.day)

    def set_day(self, day: tuple[float, float]) -> None:
        """From now on it knows the time of day about so well, also after it was switched off."""
        self.day = day
        self.clock.ahead = self.dice.uniform(*day) + self.timeline.now - self.clock.monotonic()


class Ways:
    """How the ways are now. `slow` has the latencies of some in seconds, least and most."""

    def __init__(self, dice: random.Random) -> None:
        self._dice = dice
        self.silent: set[Way] = set()
        #: The machines that hang on a cable, as hardware does.
        self.cabled: set[str] = set()
        self.slow: dict[Way, tuple[float, float]] = {}

    def delay(self, way: Way) -> float:
        """How long something takes that way, in seconds; within a machine or a cable hardly any time."""
        if way[0] == way[1] or not self.cabled.isdisjoint(way):
            return 0.0001
        return self._dice.uniform(*self.slow.get(way, LATENCY))

    def silences(self, one: str, other: str) -> bool:
        """Whether either direction is silent."""
        return (one, other) in self.silent or (other, one) in self.silent

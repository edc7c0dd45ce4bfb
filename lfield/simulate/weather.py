"""What goes wrong in a simulation, drawn from the dice of a seed: on the ways, on computers, in processes.

Each fault strikes at random and passes after a while; when the weather ends everything is healed, so that
what may go on can be seen to do so.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import permutations

from lfield.simulate.computers.computer import Process
from lfield.simulate.computers.machines import Way
from lfield.simulate.fleet import Fleet

#: How long a fault lasts at least and at most, in seconds, where nothing else is said.
LASTS = (0.05, 8.0)
#: Seconds that something takes on a slow way.
SLOW = (0.3, 2.0)
#: Seconds that a process is stopped for.
STOPPED = (0.05, 6.0)


@dataclass(frozen=True, slots=True)
class Weather:
    """Mean seconds between two faults of each kind in the whole team; 0 for none."""

    cut: float = 0.0
    one_way: float = 0.0
    reset: float = 0.0
    slow: float = 0.0
    kill: float = 0.0
    stop: float = 0.0
    power: float = 0.0
    guard_kill: float = 0.0
    guard_stop: float = 0.0

    def over(self, fleet: Fleet, dice: random.Random) -> Storm:
        """Let it break over a team from now on."""
        storm = Storm(fleet, dice)
        for name, strike in storm.kinds.items():
            if mean := getattr(self, name):
                storm.begin(mean, strike)
        return storm


class Storm:
    """The weather over one team, until `end`."""

    def __init__(self, fleet: Fleet, dice: random.Random) -> None:
        self.fleet, self._dice = fleet, dice
        #: Every fault that struck: when, and what.
        self.faults: list[tuple[float, str]] = []
        self._over = False
        hosts = list(fleet.mission.team.hosts)
        self._hosts, self._ways = hosts, list(permutations(hosts, 2))
        self.kinds: dict[str, Callable[[], None]] = {
            "cut": self._cut, "one_way": self._one_way, "reset": self._reset, "slow": self._slow,
            "kill": self._kill, "stop": self._stop, "power": self._power,
            "guard_kill": self._guard_kill, "guard_stop": self._guard_stop,
        }  # fmt: skip

    def begin(self, mean: float, strike: Callable[[], None]) -> None:
        """Let one kind of fault strike again and again."""
        self._after(self._dice.expovariate(1.0 / mean), partial(self._strike, mean, strike))

    def end(self) -> None:
        """The sun comes out: all ways speak, all computers are on, all hosts run."""
        self._over = True
        self.fleet.heal_all()

    def _strike(self, mean: float, strike: Callable[[], None]) -> None:
        if not self._over:
            strike()
            self.begin(mean, strike)

    def _after(self, seconds: float, event: Callable[[], None]) -> None:
        self.fleet.timeline.after(seconds, event)

    def _passes(self, event: Callable[[], None], lasts: tuple[float, float] = LASTS) -> None:
        self._after(self._dice.uniform(*lasts), event)

    def _note(self, what: str) -> None:
        self.faults.append((self.fleet.timeline.now, what))

    # --- ways -----------------------------------------------------------------------------------------

    def _cut(self) -> None:
        one, other = self._dice.choice(self._ways)
        self._note(f"cut {one} - {other}")
        for way in ((one, other), (other, one)):
            self.fleet.network.silence(*way)
            self._passes(partial(self.fleet.network.heal, *way))

    def _one_way(self) -> None:
        way = self._dice.choice(self._ways)
        self._note(f"silence {way[0]} > {way[1]}")
        self.fleet.network.silence(*way)
        self._passes(partial(self.fleet.network.heal, *way))

    def _reset(self) -> None:
        way = self._dice.choice(self._ways)
        self._note(f"reset {way[0]} - {way[1]}")
        self.fleet.network.reset(*way)

    def _slow(self) -> None:
        way = self._dice.choice(self._ways)
        self._note(f"slow {way[0]} > {way[1]}")
        self.fleet.network.ways.slow[way] = SLOW
        self._passes(partial(self._quick, way))

    def _quick(self, way: Way) -> None:
        self.fleet.network.ways.slow.pop(way, None)

    # --- computers and processes ----------------------------------------------------------------------

    def _host(self) -> str:
        """One that runs now; '' for none."""
        return self._dice.choice(sorted(self.fleet.lives) or [""])

    def _kill(self) -> None:
        if name := self._host():
            self._note(f"kill {name}")
            self.fleet.crash(name)
            self._passes(partial(self._start, name))

    def _power(self) -> None:
        if name := self._host():
            self._note(f"power {name}")
            self.fleet.power_off(name)
            self._passes(partial(self._start, name))

    def _stop(self) -> None:
        if name := self._host():
            self._freeze(f"stop {name}", self.fleet.lives[name].process)

    def _guard_kill(self) -> None:
        if guard := self._guard():
            self._note(f"kill a guard of {guard.loop.machine.name}")
            guard.die(-9)

    def _guard_stop(self) -> None:
        if guard := self._guard():
            self._freeze(f"stop a guard of {guard.loop.machine.name}", guard)

    def _guard(self) -> Process | None:
        hosts = [life.process for life in self.fleet.lives.values()]
        all = [process for computer in self.fleet.computers.values() for process in computer.processes]
        guards = [process for process in all if process not in hosts]
        return self._dice.choice(guards) if guards else None

    def _freeze(self, what: str, process: Process) -> None:
        self._note(what)
        process.loop.freeze()
        self._passes(process.loop.thaw, STOPPED)

    def _start(self, name: str) -> None:
        if name not in self.fleet.lives.keys() | self.fleet.left.keys():
            self.fleet.boot(name)

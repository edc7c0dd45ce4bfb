"""What is seen of a mission under test: hops, who comes to a line of L, and where devices are."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from lfield.bytecode.program import Program
from lfield.errors import MissionTestError
from lfield.simulate.fleet import Life
from lfield.testing.mission.fakes import FakeDevice
from lfield.wire.coordinators import Transfer

#: Seconds between two points of a track.
EVERY = 0.1


@dataclass(frozen=True, slots=True)
class Hop:
    """A coordinator came from one host to another; when, in seconds."""

    at: float
    agent: str
    source: str
    target: str


class Hops:
    """Every hop of a team, in order. `now` tells the time."""

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self.record: list[Hop] = []

    def watch(self, life: Life) -> None:
        """See who comes to a host."""
        core, coordinators = life.core, life.core.coordinators
        arrived = coordinators.arrived

        def seen(host: str, header: Transfer, block: memoryview) -> None:
            before = core.machine.agents.get(header.agent)
            arrived(host, header, block)
            came = core.machine.agents.get(header.agent)
            if came is not None and came is not before:
                self.record.append(Hop(self._now(), header.agent, host, core.name))

        coordinators.arrived = seen  # type: ignore[method-assign]


class Lines:
    """What is to happen when an agent comes to a line, once each. `later` does it when the moment is over."""

    def __init__(self, program: Program, later: Callable[[float, Callable[[], None]], None]) -> None:
        self._program, self._later = program, later
        self._lives: list[Life] = []
        self._waiting: list[tuple[list[int], list[Callable[[], None]]]] = []

    def when(self, line: str, action: Callable[[], None]) -> None:
        """When anybody comes to `mission.L:42`, do this. Raises MissionTestError where no code is."""
        file, _, number = line.rpartition(":")
        places = _places(self._program, file, int(number)) if number.isdecimal() else []
        if not places:
            raise MissionTestError(f"'{line}' is no line of the mission with code; write it as mission.L:42")
        self._waiting.append((places, [action]))
        for life in self._lives:
            self._stop_at(life, *self._waiting[-1])

    def watch(self, life: Life) -> None:
        """A host has begun: its machine stops at the same lines."""
        self._lives.append(life)
        for places, actions in self._waiting:
            self._stop_at(life, places, actions)

    def _stop_at(self, life: Life, places: list[int], actions: list[Callable[[], None]]) -> None:
        steps: list[Any] = life.core.machine.engine.prepared.steps
        for place in places:
            steps[place] = _stopping(steps[place], actions, self._later)


def _stopping(
    step: Callable[[Any], int],
    actions: list[Callable[[], None]],
    later: Callable[[float, Callable[[], None]], None],
) -> Callable[[Any], int]:
    def stop(registers: Any) -> int:
        while actions:
            later(0.0, actions.pop())
        return step(registers)

    return stop


def _places(program: Program, file: str, number: int) -> list[int]:
    """The instructions that begin a line."""
    return [
        at
        for method in program.debug.methods
        if program.debug.sources[method.source].name.rpartition("/")[2] == file.rpartition("/")[2]
        for at, line in method.lines
        if line == number
    ]


class Point(NamedTuple):
    """A place at a time: seconds; metres north, east and up of where the team's fakes are switched on."""

    at: float
    north: float
    east: float
    up: float


class Tracks:
    """The tracks of all devices that tell where they are. `later` calls after so many seconds."""

    def __init__(
        self,
        devices: Mapping[str, FakeDevice],
        now: Callable[[], float],
        later: Callable[[float, Callable[[], None]], None],
    ) -> None:
        self._devices, self._now, self._later = devices, now, later
        self.record: dict[str, list[Point]] = {}
        self._look()

    def _look(self) -> None:
        for name, device in self._devices.items():
            if (place := device.place) is not None:
                self.record.setdefault(name, []).append(Point(self._now(), *place))
        self._later(EVERY, self._look)

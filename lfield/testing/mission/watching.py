"""What is seen of a mission under test: the log, hops, who comes to a line of L, and where devices are."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from lfield.bytecode.opcodes import BY_CODE
from lfield.bytecode.program import MethodRecord, Program
from lfield.errors import MissionTestError
from lfield.simulate.fleet import Life
from lfield.testing.mission.fakes import FakeDevice
from lfield.vm.contract import SPENT
from lfield.vm.reference import Engine
from lfield.vm.reference.registers import LEAVE, Registers, Step
from lfield.wire.coordinators import Transfer

#: Seconds between two points of a track.
EVERY = 0.1


class Line(NamedTuple):
    """A line of the log: seconds, host, text."""

    at: float
    host: str
    text: str


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

        def seen(host: str, header: Transfer, block: memoryview, transit: float = 0.0) -> None:
            before = core.machine.agents.get(header.agent)
            arrived(host, header, block, transit)
            came = core.machine.agents.get(header.agent)
            if came is not None and came is not before:
                self.record.append(Hop(self._now(), header.agent, host, core.name))

        coordinators.arrived = seen  # type: ignore[method-assign]


@dataclass(slots=True)
class _Stop:
    """What is to happen at a line: whether somebody has come there, and whether it is done."""

    places: list[int]
    action: Callable[[], None]
    reached: bool = False
    over: bool = False

    def happen(self) -> None:
        self.over = True
        self.action()


class Lines:
    """What is to happen when an agent comes to a line, once each. `later` does it when the moment is over.

    Whoever comes there stands before the line until it is done, and its host with it. So it is also when a
    computer is switched off at a line that never waits.
    """

    def __init__(self, program: Program, later: Callable[[float, Callable[[], None]], None]) -> None:
        self._program, self._later = program, later
        self._lives: list[Life] = []
        self._stops: list[_Stop] = []

    def when(self, line: str, action: Callable[[], None]) -> None:
        """When anybody comes to `mission.L:42`, do this. Raises MissionTestError where no code is."""
        file, _, number = line.rpartition(":")
        places = _places(self._program, file, int(number)) if number.isdecimal() else []
        if not places:
            raise MissionTestError(f"'{line}' is no line of the mission with code; write it as mission.L:42")
        self._stops.append(_Stop(places, action))
        for life in self._lives:
            self._stop_in(life, self._stops[-1])

    def watch(self, life: Life) -> None:
        """A host has begun: its machine stops at the same lines."""
        self._lives.append(life)
        for stop in self._stops:
            self._stop_in(life, stop)

    def _stop_in(self, life: Life, stop: _Stop) -> None:
        engine = life.core.machine.engine
        assert isinstance(engine, Engine), "the simulator runs on the reference engine"
        steps = engine.prepared.steps
        for place in stop.places:
            steps[place] = self._stopping(life, stop, steps[place])

    def _stopping(self, life: Life, stop: _Stop, step: Step) -> Step:
        def stopping(registers: Registers) -> int:
            if stop.over:
                return step(registers)
            if not stop.reached:
                stop.reached = True
                self._later(0.0, stop.happen)
            life.process.loop.hold()
            registers.exit = SPENT
            return LEAVE

        return stopping


def _places(program: Program, file: str, number: int) -> list[int]:
    """The instructions by which one can come to a line: where it begins, and what is jumped to in it."""
    name = file.rpartition("/")[2]
    found = []
    for record, method in zip(program.core.methods, program.debug.methods, strict=True):
        if program.debug.sources[method.source].name.rpartition("/")[2] != name:
            continue
        entered = _targets(program, record)
        for (first, line), (end, _) in pairwise([*method.lines, (record.end, 0)]):
            if line == number:
                found += [at for at in range(first, end) if at == first or at in entered]
    return found


def _targets(program: Program, method: MethodRecord) -> set[int]:
    """The instructions that a method jumps to, or where it catches."""
    quads = program.quads[method.entry : method.end]
    jumps = {quad.a for quad in quads if BY_CODE[quad.op].name in ("jmp", "bnz", "bz")}
    return jumps | {handler.target for handler in method.handlers}


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

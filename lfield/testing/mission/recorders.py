"""Recorders of a mission under test: log, hops, lines of L, and tracks of devices."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from lfield.bytecode.opcodes import BY_CODE
from lfield.bytecode.program import MethodRecord, Program
from lfield.errors import MissionTestError
from lfield.simulate.host_fleet import HostRun
from lfield.testing.mission.mission_fakes import FakeDevice
from lfield.vm.agent import Agent
from lfield.vm.engine_interface import BUDGET_EXHAUSTED
from lfield.vm.reference import ReferenceEngine
from lfield.vm.reference.call_steps import Registers, Step

#: Seconds between two points of a track.
TRACK_INTERVAL = 0.1


class Line(NamedTuple):
    """A log line: seconds, host, text."""

    at: float
    host: str
    text: str


@dataclass(frozen=True, slots=True)
class Hop:
    """A migration of a coordinator from one host to another; time in seconds."""

    at: float
    agent: str
    source: str
    target: str


class HopRecorder:
    """Every hop of a team, in order. `now` returns the time."""

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self.record: list[Hop] = []

    def observe(self, run: HostRun) -> None:
        """Records arrivals at a host."""
        core = run.core

        def on_arrival(agent: Agent) -> None:
            source = core.mission.team.hosts[agent.block.trail()[-2]]
            self.record.append(Hop(self._now(), agent.id, source, core.name))

        core.machine.hooks.watch_arrivals(on_arrival)


@dataclass(slots=True)
class _Stop:
    """An action at a line: whether the line was reached, and whether the action is done."""

    places: list[int]
    action: Callable[[], None]
    reached: bool = False
    over: bool = False

    def happen(self) -> None:
        self.over = True
        self.action()


class LineStops:
    """Actions at lines of L, once each. `later` runs an action at the end of the present moment.

    The agent stops before the line until the action is done, and its host with it; also when a computer is
    switched off at a line that never waits.
    """

    def __init__(self, program: Program, later: Callable[[float, Callable[[], None]], None]) -> None:
        self._program, self._later = program, later
        self._runs: list[HostRun] = []
        self._stops: list[_Stop] = []

    def when(self, line: str, action: Callable[[], None]) -> None:
        """Runs an action when any agent reaches `mission.L:42`. Raises MissionTestError for a line without
        code.
        """
        file, _, number = line.rpartition(":")
        places = _places(self._program, file, int(number)) if number.isdecimal() else []
        if not places:
            raise MissionTestError(
                f"'{line}' is not a line of the mission with code; write it as mission.L:42"
            )
        self._stops.append(_Stop(places, action))
        for run in self._runs:
            self._stop_in(run, self._stops[-1])

    def attach(self, run: HostRun) -> None:
        """Sets the lines in the VM of a host that has started."""
        self._runs.append(run)
        for stop in self._stops:
            self._stop_in(run, stop)

    def _stop_in(self, run: HostRun, stop: _Stop) -> None:
        engine = run.core.machine.engine
        assert isinstance(engine, ReferenceEngine), "the simulator runs on the reference engine"
        steps = engine.prepared.steps
        for place in stop.places:
            steps[place] = self._stopping(run, stop, steps[place])

    def _stopping(self, run: HostRun, stop: _Stop, step: Step) -> Step:
        def stopping(registers: Registers) -> int:
            if stop.over:
                return step(registers)
            if not stop.reached:
                stop.reached = True
                self._later(0.0, stop.happen)
            run.process.loop.hold()
            return registers.leave(BUDGET_EXHAUSTED)

        return stopping


def _places(program: Program, file: str, number: int) -> list[int]:
    """The instructions at which a line is entered: its start, and jump targets in it."""
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
    """The jump targets and exception handlers of a method."""
    quads = program.quads[method.entry : method.end]
    jumps = {quad.a for quad in quads if BY_CODE[quad.op].name in ("jmp", "bnz", "bz")}
    return jumps | {handler.target for handler in method.handlers}


class Point(NamedTuple):
    """A position at a time: seconds; metres north, east and up of the place of power-on of the team's
    simulated devices.
    """

    at: float
    north: float
    east: float
    up: float


class TrackRecorder:
    """The tracks of all devices with a known position. `later` calls after so many seconds."""

    def __init__(
        self,
        devices: Mapping[str, FakeDevice],
        now: Callable[[], float],
        later: Callable[[float, Callable[[], None]], None],
    ) -> None:
        self._devices, self._now, self._later = devices, now, later
        self.record: dict[str, list[Point]] = {}
        self._sample()

    def _sample(self) -> None:
        for name, device in self._devices.items():
            if (place := device.place) is not None:
                self.record.setdefault(name, []).append(Point(self._now(), *place))
        self._later(TRACK_INTERVAL, self._sample)

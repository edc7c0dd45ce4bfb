"""Golden programs: a few lines of L with the expectation on the line itself.

    write("a"); write("\n");     // expect: a
    throw new NullException("x"); // throws: NullException: x
    // deploy: Server:s1?5&3      (optional; else one agent of each unit, its id the type in lower case)
    // registry: lifting.yaml     (optional; a registry of capabilities, beside the program)

`expect` lines are compared with everything the agents write and print, in order; `throws` with what
agents died of. The program runs on one host in memory, with a clock that jumps to the next timer.
"""

from __future__ import annotations

import random
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from lfield.bytecode.program import DeviceCall, Program
from lfield.capability.model import Registry
from lfield.capability.reading.reader import read_registry
from lfield.capability.types.language import RegistryTypes
from lfield.clock import ManualClock
from lfield.compiler.build import compile_program
from lfield.errors import DeviceError
from lfield.host.offers import Answers
from lfield.lang.frontend import check_text
from lfield.manifest import DeviceValue
from lfield.testing.offers import still_answers
from lfield.vm.agent import Agent, Member
from lfield.vm.begun import Beginning, Begun
from lfield.vm.contract import Limits, Reading, Trap
from lfield.vm.machine import Machine
from lfield.vm.offers import Found
from lfield.vm.world import Pending

#: Virtual seconds after which a golden program that still sleeps is stopped.
PATIENCE = 1000.0
#: Rounds of the machine after which a program that never pauses is stopped.
ROUNDS = 500

_EXPECT = re.compile(r"//\s*expect:\s?(.*?)\s*$", re.MULTILINE)
_THROWS = re.compile(r"//\s*throws:\s*(.*?)\s*$", re.MULTILINE)
_DEPLOY = re.compile(r"//\s*deploy:\s*(\w+):(\w+)(?:\?(\S*))?\s*$", re.MULTILINE)
_REGISTRY = re.compile(r"//\s*registry:\s*(\S+)\s*$", re.MULTILINE)


def compile_text(text: str, name: str = "golden.L", registry: Registry | None = None) -> Program:
    """A program from L text; raises ProgramError."""
    types = None if registry is None else RegistryTypes(lambda: registry)
    return compile_program(check_text(text, name, capabilities=types).or_raise())


@dataclass
class Desk:
    """A world with nothing in it: output is kept, devices refuse, nobody is elsewhere."""

    output: list[str] = field(default_factory=list)
    endings: list[Agent] = field(default_factory=list)
    departures: list[tuple[Agent, Member]] = field(default_factory=list)
    answers: Answers | None = None
    machine: Machine = field(init=False)
    #: By resource: the number of its last reservation, and the coordinator that has it, '' for nobody.
    reserved: dict[str, tuple[int, str]] = field(default_factory=dict)

    def write(self, agent: Agent, text: str) -> None:
        """Keep written text, line by line."""
        self.output.extend(text.removesuffix("\n").split("\n"))

    def log(self, agent: Agent, text: str) -> None:
        """Keep a printed text, line by line."""
        self.output.extend(text.split("\n"))

    def depart(self, agent: Agent, resource: Member) -> None:
        """Note who wants to leave; a test lets it."""
        self.departures.append((agent, resource))

    def may_begin(self, agent: Agent, acts: bool) -> bool:
        """There is no disk, and no team."""
        return True

    def take(self, agent: Agent, resource: Member, *, nested: bool) -> int:
        """Whoever comes first has it; everybody else is refused at once."""
        number, holder = self.reserved.get(resource.id, (0, ""))
        if holder not in ("", agent.id):
            raise Trap("ReservedException", f"{resource.id} is reserved by {holder}", resource.id)
        if not holder:
            number += 1
        self.reserved[resource.id] = number, agent.id
        self.machine.agents[resource.id].reserved = True
        return number

    def drop(self, agent: Agent, held: Sequence[tuple[Member, int]]) -> None:
        """It is free again, if it was not lost before."""
        for resource, number in held:
            if self.reserved.get(resource.id) == (number, agent.id):
                self.reserved[resource.id] = number, ""
                self.machine.agents[resource.id].reserved = False

    def serves(self, agent: Agent, resource: Member, number: int) -> bool:
        """Whoever has it by its last number, and everybody while nobody has it."""
        last, holder = self.reserved.get(resource.id, (0, ""))
        if number and (number, agent.id) != (last, holder):
            raise Trap("ReservationLostException", f"{resource.id} is not reserved any more", resource.id)
        if not number and holder:
            raise Trap("ReservedException", f"{resource.id} is reserved by {holder}", resource.id)
        return True

    def begins(self, agent: Agent, calls: Sequence[Beginning]) -> bool:
        """As `may_begin`."""
        return True

    def came_back(self, begun: Begun) -> None:
        """What came back is kept at once, since nothing is."""
        self.machine.kept_result(begun.key)

    def give_up(self, agent: Agent) -> bool:
        """Whoever waits to leave is still here; nobody else is frozen."""
        waiting = [pair for pair in self.departures if pair[0] is not agent]
        given_up = len(waiting) < len(self.departures)
        self.departures[:] = waiting
        return given_up

    def cancel(self, agent: Agent, thread: int) -> bool:
        """There is no hardware that could be waited for."""
        return False

    def superseded(self, agent: str, generation: int) -> bool:
        """There is one start of each."""
        return False

    def host_of(self, member: Member) -> str:
        """There is one host."""
        return "desk"

    def device(
        self, agent: Agent, thread: int, call: DeviceCall, values: list[DeviceValue]
    ) -> DeviceValue | Pending:
        """There is no hardware here."""
        raise DeviceError(call.field, "a golden program has no devices")

    def reading(self, agent: Agent, call: DeviceCall) -> Reading | None:
        """There is no telemetry either."""
        return None

    def offers(self, agent: Agent, capability: str, constraint: str | None) -> Sequence[Found]:
        """What the registry knows, if there is one."""
        return self.answers.offers(capability, constraint) if self.answers else []

    def teams(
        self, agent: Agent, capability: str, constraint: str | None, size: int
    ) -> Sequence[Sequence[Found]]:
        """The teams of what the registry knows."""
        return self.answers.teams(capability, constraint, size) if self.answers else []

    def explain(self, agent: Agent, capability: str, constraint: str | None) -> str:
        """Why the others do not, if there is a registry."""
        return self.answers.explain(capability, constraint) if self.answers else ""

    def ended(self, agent: Agent) -> None:
        """Keep the agents that ended."""
        self.endings.append(agent)


def team_for(program: Program, deployed: list[tuple[str, str, str]]) -> list[Member]:
    """Members on host 0 for (type, id, arguments joined by &); one of each unit when none are given."""
    units = {name: kind for name, kind in program.units.items() if kind != "class"}
    if not deployed:
        deployed = [(name, name.lower(), "") for name in units]
    return [
        Member(i, identity, name, units[name], 0, tuple(a for a in arguments.split("&") if a))
        for i, (name, identity, arguments) in enumerate(deployed)
    ]


def run_text(
    text: str, limits: Limits | None = None, name: str = "golden.L", registry: Registry | None = None
) -> tuple[Desk, Machine]:
    """Run a golden program to its end (or to where only the world could go on)."""
    program = compile_text(text, name, registry)
    desk, clock = Desk(), ManualClock()
    team = team_for(program, _DEPLOY.findall(text))
    if registry is not None:
        desk.answers = still_answers(registry, program, team)
    machine = desk.machine = Machine(program, team, 0, 1, desk, clock, random.Random(1))
    for member in team:
        machine.start(member, limits or Limits(), generation=1)
    settle(machine, clock)
    return desk, machine


def settle(machine: Machine, clock: ManualClock) -> None:
    """Run until nothing can happen any more, jumping over every wait."""
    end = clock.now + PATIENCE
    for _ in range(ROUNDS):
        pause = machine.run()
        if pause is None or clock.now >= end:
            return
        clock.advance(pause)


def check(path: Path, limits: Limits | None = None) -> None:
    """Run the golden program in a file; AssertionError says what differed."""
    text = path.read_text(encoding="utf-8")
    files = [path.with_name(name) for name in _REGISTRY.findall(text)]
    desk, _ = run_text(text, limits, path.name, read_registry(files) if files else None)
    expected = _EXPECT.findall(text)
    assert desk.output == expected, f"{path.name}: expected {expected}, got {desk.output}"
    deaths = [agent.report.splitlines()[0] for agent in desk.endings if agent.ended == "died"]
    assert deaths == _THROWS.findall(text), f"{path.name}: agents died of {deaths}"

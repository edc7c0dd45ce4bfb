"""Golden programs: a few lines of L with the expectation on the line itself.

    write("a"); write("\n");     // expect: a
    throw new NullException("x"); // throws: NullException: x
    // deploy: Server:s1?5&3      (optional; else one agent of each unit, its id the type in lower case)
    // registry: lifting.yaml     (optional; a registry of capabilities, beside the program)
    // startable: Patrol:patrol   (optional; as deploy, of a coordinator that the program starts)
    // input: yes                 (optional; a line of operator input that is entered at the start)

`expect` lines are compared with all text that the agents write and print, in order; `throws` with the
exceptions that ended agents. The program runs on one host in memory, with a clock that jumps to the next
timer.
"""

from __future__ import annotations

import random
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from msgspec.structs import replace

from lfield.bytecode.program import DeviceCallRecord, Program
from lfield.capability.model import Registry
from lfield.capability.program_types.registry_types import RegistryTypes
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.clock import ManualClock
from lfield.compiler.program_builder import compile_program
from lfield.errors import DeviceError
from lfield.host.offer_queries import MatchResults
from lfield.lang.frontend import check_text
from lfield.manifest import DeviceValue
from lfield.testing.golden_sequencer import GoldenSequencer
from lfield.testing.still_team import still_answers
from lfield.text.log_messages import LogLine
from lfield.vm.agent import Agent, MachineTeam, TeamMember
from lfield.vm.engine_interface import AgentLimits, Reading, Trap
from lfield.vm.host_interface import Pending
from lfield.vm.machine import Machine
from lfield.vm.offer_objects import FoundOffer
from lfield.vm.pending_call import CallRequest, PendingCall

#: Virtual seconds after which a golden program that still sleeps is stopped.
PATIENCE = 1000.0
#: Rounds of the VM after which a program that never pauses is stopped.
ROUNDS = 500

_EXPECT = re.compile(r"//\s*expect:\s?(.*?)\s*$", re.MULTILINE)
_THROWS = re.compile(r"//\s*throws:\s*(.*?)\s*$", re.MULTILINE)
_DEPLOY = re.compile(r"//\s*deploy:\s*(\w+):(\w+)(?:\?(\S*))?\s*$", re.MULTILINE)
_STARTABLE = re.compile(r"//\s*startable:\s*(\w+):(\w+)(?:\?(\S*))?\s*$", re.MULTILINE)
_INPUT = re.compile(r"//\s*input:\s?(.*?)\s*$", re.MULTILINE)
_REGISTRY = re.compile(r"//\s*registry:\s*(\S+)\s*$", re.MULTILINE)


def compile_text(text: str, name: str = "golden.L", registry: Registry | None = None) -> Program:
    """Compiles L text; raises ProgramError."""
    types = None if registry is None else RegistryTypes(lambda: registry)
    return compile_program(check_text(text, name, capabilities=types).or_raise())


@dataclass
class GoldenWorld:
    """A minimal host: records output, refuses devices, and has no peers."""

    output: list[str] = field(default_factory=list)
    endings: list[Agent] = field(default_factory=list)
    departures: list[tuple[Agent, TeamMember]] = field(default_factory=list)
    answers: MatchResults | None = None
    machine: Machine = field(init=False)
    #: By resource: the number of its last reservation, and the coordinator that holds it, '' for none.
    reserved: dict[str, tuple[int, str]] = field(default_factory=dict)
    sequencer: GoldenSequencer = field(default_factory=GoldenSequencer)

    def write(self, agent: Agent, text: str) -> None:
        """Records written text, line by line."""
        self.output.extend(text.removesuffix("\n").split("\n"))

    def on_input_awaited(self, agent: Agent, seconds: float) -> None:
        """Has no effect: no operator is asked."""

    def on_line_read(self, agent: Agent, text: str) -> None:
        """Has no effect: the program shows the line."""

    def on_readers_changed(self, agents: Sequence[str]) -> None:
        """Has no effect: a golden program has no page."""

    def log(self, agent: Agent, text: str) -> None:
        """Records a printed text, line by line."""
        self.output.extend(text.split("\n"))

    def report(self, agent: Agent, line: LogLine) -> None:
        """Records the code of a line."""
        self.output.append(line.code)

    def depart(self, agent: Agent, resource: TeamMember) -> None:
        """Records the migration; a test performs it."""
        self.departures.append((agent, resource))

    def may_start_call(self, agent: Agent, acts: bool) -> bool:
        """Always True: a golden program has no disk and no team."""
        return True

    def acquire_reservation(self, agent: Agent, resource: TeamMember, *, nested: bool) -> int:
        """Gives a resource to the first caller; others are refused immediately."""
        number, holder = self.reserved.get(resource.id, (0, ""))
        if holder not in ("", agent.id):
            raise Trap("ReservedException", f"{resource.id} is reserved by {holder}", resource.id)
        if not holder:
            number += 1
        self.reserved[resource.id] = number, agent.id
        self.machine.agents[resource.id].mark_reserved(is_reserved=True)
        return number

    def release_reservations(self, agent: Agent, held: Sequence[tuple[TeamMember, int]]) -> None:
        """Releases reservations that were not lost before."""
        for resource, number in held:
            if self.reserved.get(resource.id) == (number, agent.id):
                self.reserved[resource.id] = number, ""
                self.machine.agents[resource.id].mark_reserved(is_reserved=False)

    def may_serve(self, agent: Agent, resource: TeamMember, number: int) -> bool:
        """Whether the caller is the holder by its last number, or the resource is free."""
        last, holder = self.reserved.get(resource.id, (0, ""))
        if number and (number, agent.id) != (last, holder):
            raise Trap("ReservationLostException", f"{resource.id} is no longer reserved", resource.id)
        if not number and holder:
            raise Trap("ReservedException", f"{resource.id} is reserved by {holder}", resource.id)
        return True

    def may_start_calls(self, agent: Agent, calls: Sequence[CallRequest]) -> bool:
        """Always True, as `may_start_call`."""
        return True

    def on_call_completed(self, call: PendingCall) -> None:
        """Counts the result as persisted at once: a golden program has no journal."""
        self.machine.pending_calls.on_persisted(call.key)

    def request_cancels(self, agent: Agent, calls: Sequence[tuple[TeamMember, int]]) -> None:
        """Has no effect: no call runs elsewhere."""

    def watch_calls(self, agent: Agent, calls: Sequence[tuple[TeamMember, int]]) -> None:
        """Has no effect: no call runs elsewhere, as there is one host."""

    def abandon_wait(self, agent: Agent) -> bool:
        """Has no effect: a waiting agent is still on this host; others are not frozen."""
        if self.sequencer.abandon_wait(agent):
            return True
        waiting = [pair for pair in self.departures if pair[0] is not agent]
        given_up = len(waiting) < len(self.departures)
        self.departures[:] = waiting
        return given_up

    def cancel(self, agent: Agent, thread: int) -> bool:
        """Always False: a golden program has no hardware to wait for."""
        return False

    def is_superseded(self, agent: str, generation: int) -> bool:
        """Always False: each agent has one epoch."""
        return False

    def host_of(self, member: TeamMember) -> str:
        return "desk"

    def call_device(
        self, agent: Agent, thread: int, call: DeviceCallRecord, values: list[DeviceValue]
    ) -> DeviceValue | Pending:
        raise DeviceError(call.field, "a golden program has no devices")

    def telemetry_reading(self, agent: Agent, call: DeviceCallRecord) -> Reading | None:
        return None

    def offers(self, agent: Agent, capability: str, constraint: str | None) -> Sequence[FoundOffer]:
        """The offers of the registry, if there is one."""
        return self.answers.find_offers(capability, constraint) if self.answers else []

    def teams(
        self, agent: Agent, capability: str, constraint: str | None, size: int
    ) -> Sequence[Sequence[FoundOffer]]:
        """The teams of the registry's offers."""
        return self.answers.find_teams(capability, constraint, size) if self.answers else []

    def explain(self, agent: Agent, capability: str, constraint: str | None) -> str:
        """The reasons why other resources do not match, if there is a registry."""
        return self.answers.explain_others(capability, constraint) if self.answers else ""

    def ended(self, agent: Agent) -> None:
        """Records agents that ended."""
        self.endings.append(agent)
        self.sequencer.on_ended(agent)


def team_for(program: Program, deployed: list[tuple[str, str, str]]) -> list[TeamMember]:
    """Members on host 0 for (type, id, arguments joined by &); one of each unit if none are given."""
    units = {name: kind for name, kind in program.units.items() if kind != "class"}
    if not deployed:
        deployed = [(name, name.lower(), "") for name in units]
    return [
        TeamMember(i, identity, name, units[name], 0, tuple(a for a in arguments.split("&") if a))
        for i, (name, identity, arguments) in enumerate(deployed)
    ]


def startable_in(text: str, program: Program, first: int) -> list[TeamMember]:
    """The startable coordinators of a golden program; the first has this number."""
    found = team_for(program, _STARTABLE.findall(text)) if _STARTABLE.search(text) else []
    return [replace(member, number=first + member.number, is_startable=True) for member in found]


def run_text(
    text: str, limits: AgentLimits | None = None, name: str = "golden.L", registry: Registry | None = None
) -> tuple[GoldenWorld, Machine]:
    """Runs a golden program to its end (or until it needs another host)."""
    program = compile_text(text, name, registry)
    desk, clock = GoldenWorld(), ManualClock()
    team = team_for(program, _DEPLOY.findall(text))
    startable = startable_in(text, program, len(team))
    if registry is not None:
        desk.answers = still_answers(registry, program, team)
    view = MachineTeam([*team, *startable], 0, 1)
    machine = desk.machine = Machine(program, view, desk, clock, random.Random(1))
    desk.sequencer.attach(machine)
    for line in _INPUT.findall(text):
        machine.operator_input.enter(line, is_kept=True)
    for member in team:
        machine.start(member, limits or AgentLimits(), generation=1)
    run_until_idle(machine, clock)
    return desk, machine


def run_until_idle(machine: Machine, clock: ManualClock) -> None:
    """Runs until no event is pending, skipping all waits."""
    end = clock.now + PATIENCE
    for _ in range(ROUNDS):
        pause = machine.run()
        if pause is None or clock.now >= end:
            return
        clock.advance(pause)


def check(path: Path, limits: AgentLimits | None = None) -> None:
    """Runs the golden program in a file; AssertionError describes a difference."""
    text = path.read_text(encoding="utf-8")
    files = [path.with_name(name) for name in _REGISTRY.findall(text)]
    desk, _ = run_text(text, limits, path.name, read_registry(files) if files else None)
    expected = _EXPECT.findall(text)
    assert desk.output == expected, f"{path.name}: expected {expected}, got {desk.output}"
    deaths = [agent.report.splitlines()[0] for agent in desk.endings if agent.ended == "died"]
    assert deaths == _THROWS.findall(text), f"{path.name}: agents died of {deaths}"

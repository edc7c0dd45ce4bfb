"""Runs one program on two engines, on one host in memory, until its end or limits."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from engine_fuzzer.engine_pair import EnginePair, TrialOver
from lfield.bytecode.program import Program
from lfield.capability.model import Registry
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.clock import ManualClock
from lfield.testing.golden import GoldenWorld, compile_text, startable_in, team_for
from lfield.testing.still_team import still_answers
from lfield.vm.agent import MachineTeam
from lfield.vm.engine_interface import AgentLimits, Engines
from lfield.vm.machine import Machine

#: The most instructions of a trial, and the most rounds of the machine.
LONGEST, ROUNDS = 10_000, 150
#: The latest time of the virtual clock (s): engines count nanoseconds in 64 bits, which is 292 years.
LATEST = 9e9
#: A comment that selects large limits for a program.
ENOUGH_HEAP = "// room: enough"
#: The registry of programs with queries, named in their comment.
_REGISTRY = Path(__file__).parents[2] / "golden" / "programs" / "hauling.yaml"
_DEPLOY = re.compile(r"//\s*deploy:\s*(\w+):(\w+)(?:\?(\S*))?\s*$", re.MULTILINE)


@dataclass(frozen=True)
class TrialOutcome:
    """The result of a trial: differences, the number of instructions of both, and the number of slices."""

    differences: tuple[str, ...]
    instructions: int
    slices: int


@cache
def _registry() -> Registry:
    return read_registry([_REGISTRY])


def registry_of(text: str) -> Registry | None:
    """The registry that a program needs, or None."""
    return _registry() if f"// registry: {_REGISTRY.name}" in text else None


def compiled(text: str) -> Program:
    """Compile a random program. Raises ProgramError."""
    return compile_text(text, registry=registry_of(text))


def random_limits(rng: random.Random) -> AgentLimits:
    """Limits that programs reach: heaps of few objects, and of many."""
    return AgentLimits(
        heap=rng.choice((6 << 10, 8 << 10, 12 << 10, 32 << 10, 1 << 20)),
        call_depth=rng.choice((5, 12, 40, 200)),
        array_length=rng.choice((4, 30, 5000)),
        string_length=rng.choice((6, 40, 2000)),
    )


def run_trial(program: Program, text: str, seed: int, engines: Engines) -> TrialOutcome:
    """Run a program on an engine and the reference engine; the seed decides limits and slices.

    Comments of the text name the agents, as in golden programs, and may contain ROOM.
    """
    rng = random.Random(seed)
    limits = AgentLimits() if ENOUGH_HEAP in text else random_limits(rng)
    desk, clock = GoldenWorld(), ManualClock()
    pairs: list[EnginePair] = []

    def twin(program: Program, now: Callable[[], float]) -> EnginePair:
        pairs.append(EnginePair(program, now, engines, rng, LONGEST))
        return pairs[0]

    members = team_for(program, _DEPLOY.findall(text))
    if registry := registry_of(text):
        desk.answers = still_answers(registry, program, members)
    view = MachineTeam([*members, *startable_in(text, program, len(members))], 0, 1)
    machine = desk.machine = Machine(program, view, desk, clock, random.Random(1), engines=twin)
    desk.sequencer.attach(machine)
    for line in ("7", "", "caf\u00e9 \N{ROBOT FACE}" * 40):
        machine.operator_input.enter(line, is_kept=True)
    for member in members:
        machine.start(member, limits, generation=1)
    for _ in range(ROUNDS):
        pause = machine.run()
        if pause is None or pairs[0].done >= LONGEST or pairs[0].differences:
            break
        if clock.now + pause > LATEST:
            break
        clock.advance(pause)
    return TrialOutcome(tuple(pairs[0].differences) or _bugs(desk), pairs[0].done, pairs[0].exits)


def _bugs(desk: GoldenWorld) -> tuple[str, ...]:
    """First lines of the reports of agents that ended by a bug in lfield, without the end of the trial."""
    lines = [agent.report.splitlines()[0] for agent in desk.endings if agent.report]
    return tuple(line for line in lines if "bug in lfield" in line and TrialOver.__name__ not in line)

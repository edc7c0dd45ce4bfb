"""One program on two engines, on one host in memory, until it ends or has had enough."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from dataclasses import dataclass

from lfield.bytecode.program import Program
from lfield.clock import ManualClock
from lfield.testing.fuzz.twin import Enough, Twin
from lfield.testing.golden import Desk, team_for
from lfield.vm.contract import Engines, Limits
from lfield.vm.machine import Machine

#: Instructions that one trial does at most, and rounds of the machine.
LONGEST, ROUNDS = 6000, 150
_DEPLOY = re.compile(r"//\s*deploy:\s*(\w+):(\w+)(?:\?(\S*))?\s*$", re.MULTILINE)


@dataclass(frozen=True)
class Outcome:
    """What came of a trial: what differed, how many instructions both did, and in how many slices."""

    differences: tuple[str, ...]
    instructions: int
    slices: int


def random_limits(dice: random.Random) -> Limits:
    """Limits that programs come to: heaps of a few objects, and of many."""
    return Limits(
        heap=dice.choice((6 << 10, 8 << 10, 12 << 10, 32 << 10, 1 << 20)),
        call_depth=dice.choice((5, 12, 40, 200)),
        array_length=dice.choice((4, 30, 5000)),
        string_length=dice.choice((6, 40, 2000)),
    )


def deployed(text: str) -> list[tuple[str, str, str]]:
    """The agents that a text asks for in comments, as golden programs do."""
    return _DEPLOY.findall(text)


def tried(program: Program, team: list[tuple[str, str, str]], seed: int, engines: Engines) -> Outcome:
    """Run a program on an engine and the reference engine; the seed decides limits and slices."""
    dice = random.Random(seed)
    limits = random_limits(dice)
    desk, clock = Desk(), ManualClock()
    made: list[Twin] = []

    def twin(program: Program, now: Callable[[], float]) -> Twin:
        made.append(Twin(program, now, engines, dice, LONGEST))
        return made[0]

    members = team_for(program, team)
    machine = desk.machine = Machine(program, members, 0, 1, desk, clock, random.Random(1), engines=twin)
    for member in members:
        machine.start(member, limits, generation=1)
    for _ in range(ROUNDS):
        pause = machine.run()
        if pause is None or made[0].done >= LONGEST or made[0].differences:
            break
        clock.advance(pause)
    return Outcome(tuple(made[0].differences) or _bugs(desk), made[0].done, made[0].exits)


def _bugs(desk: Desk) -> tuple[str, ...]:
    """What an agent has died of that is neither L's nor the end of the trial."""
    lines = [agent.report.splitlines()[0] for agent in desk.endings if agent.report]
    return tuple(line for line in lines if "bug in lfield" in line and Enough.__name__ not in line)

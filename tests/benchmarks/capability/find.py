"""A query of the registry: a thousand agents, a condition with five parts, from L and in the matcher alone.

In a still team nothing changes between queries. In a lively one every agent has told its battery anew before
each of them, so that all offers are made again.
"""

from __future__ import annotations

import math
import random
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from harness import Figure, Row, in_turns, median, milliseconds, percentile, timed, times

from lfield.bytecode.program import Program
from lfield.capability.matching.expression import compile_constraint
from lfield.capability.matching.matcher import Matcher
from lfield.capability.model import Registry
from lfield.capability.offer import Candidate, Fact
from lfield.capability.reading.reader import read_registry
from lfield.clock import SystemClock
from lfield.fleet.answers import Answers
from lfield.testing.golden import Desk, compile_text, team_for
from lfield.vm.limits import Limits
from lfield.vm.machine import Machine
from lfield.vm.offers import ways

AGENTS, MORE_AGENTS, ROUNDS, QUERIES = 1000, 4000, 10, 5
#: Seconds that a query of AGENTS may take from L.
TARGET = 5e-3

_REGISTRY = """
registry: 1
taxonomy:
  skill: {meaning: behaviours}
  skill.lifting: {meaning: raises a load}
attributes:
  payload: {type: real, unit: kg, better: more, typical: 2.0, meaning: what it can carry}
  reach: {type: real, unit: m, better: more, typical: 1.0, meaning: how far it gets}
  mass: {type: real, unit: kg, better: less, typical: 9.0, meaning: its own}
  battery: {type: real, better: more, typical: 1.0, live: true, max_age: 10.0, meaning: from 0 to 1}
  environment: {type: set, values: [aerial, terrestrial], meaning: where it can work}
primitives:
  Lift: {id: skill.lifting, portals: {lift: {parameters: {height: {type: real, unit: m}}}}}
providers:
  Crane: {attributes: {environment: [terrestrial], battery: 0.9}, serves: {Lift: {}}}
"""
_CONDITION = "payload >= 2.0 && reach > 0.5 && mass < 90.0 && environment == terrestrial && battery >= 0.2"
_PROGRAM = f"""
resource Crane {{
    init(string[] arg) {{ }}
    portal lift(real height) {{ }}
}}
coordinator Boss {{
    init(string[] arg) {{
        for (int i = 0; i < {QUERIES}; i = i + 1) {{
            real start = now();
            Lift[] who = findLift("{_CONDITION}");
            print(now() - start);
            if (who.length() != %d) throw new Exception("who is missing?");
        }}
    }}
}}
"""


class Cranes:
    """A team of cranes. A `lively` one has new batteries whenever it is asked, outside the measured time."""

    def __init__(self, count: int, lively: bool) -> None:
        chance = random.Random(1)
        self.lively = lively
        self.members = [
            Candidate(
                f"crane{i}",
                "Crane",
                f"host{i % 50}",
                hops=1,
                facts={
                    "payload": Fact(chance.uniform(2.0, 9.0)),
                    "reach": Fact(chance.uniform(1.0, 3.0)),
                    "mass": Fact(chance.uniform(5.0, 50.0)),
                },
            )
            for i in range(count)
        ]

    def candidates(self, resource: str) -> Sequence[Candidate]:
        """All of them."""
        return self.members if resource == "Crane" else []

    def live(self, step: int) -> None:
        """Tell all batteries anew."""
        if self.lively:
            told = Fact(0.5 + 0.001 * step, 1.0)
            self.members = [replace(m, facts={**m.facts, "battery": told}) for m in self.members]


def figure() -> Figure:
    """From L, in the matcher, and the growth with the number of agents."""
    made = _registry()
    few, many = Cranes(AGENTS, lively=False), Cranes(MORE_AGENTS, lively=False)
    lively = Cranes(AGENTS, lively=True)
    samples = in_turns(
        {
            "from L": _from_l(made, few),
            "matcher": _matching(made, few),
            "lively": _matching(made, lively),
            "many": _matching(made, many),
        },
        ROUNDS,
    )
    growth = MORE_AGENTS * math.log(MORE_AGENTS) / (AGENTS * math.log(AGENTS))
    grown = median(samples["many"]) / median(samples["matcher"])
    rows = (
        _row(f"{AGENTS} agents", "findLift from L", samples["from L"], f"{TARGET * 1e3:g} ms"),
        _row("", "the matcher's part", samples["matcher"]),
        _row("", "the same, all batteries changed", samples["lively"]),
        _row(f"{MORE_AGENTS} agents", "the matcher's part", samples["many"]),
        Row("", f"growth from {AGENTS}", times(grown), "", times(grown / growth), f"{growth:.2f}x, n log n"),
    )
    note = f"{ROUNDS} rounds of {QUERIES} queries, 5 conditions that all agents fulfil; the first is left out"
    return Figure("A query of the registry; ratio to the target, of growth to n log n", rows, (note,))


def _row(case: str, measured: str, own: list[float], target: str = "") -> Row:
    middle = median(own)
    ratio = times(middle / TARGET)
    return Row(case, measured, milliseconds(middle), milliseconds(percentile(own, 99)), ratio, target)


def _registry() -> Registry:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "cranes.yaml"
        file.write_text(_REGISTRY, encoding="utf-8")
        return read_registry([file])


def _matching(made: Registry, team: Cranes) -> Callable[[], list[float]]:
    """Seconds of each of some queries, the condition compiled before."""
    matcher = Matcher(made, team)
    constraint = compile_constraint(_CONDITION, made.attributes)
    assert len(matcher.offers("Lift", constraint)) == len(team.members)

    def queries() -> list[float]:
        samples = []
        for step in range(QUERIES):
            team.live(step)
            samples.append(timed(lambda: matcher.offers("Lift", constraint)))
        return samples

    return queries


def _from_l(made: Registry, team: Cranes) -> Callable[[], list[float]]:
    """Seconds as an L program measures them itself, with all offers as objects in its heap."""
    program: Program = compile_text(_PROGRAM % len(team.members), registry=made)
    agents = [("Boss", "boss", ""), *(("Crane", member.agent, "") for member in team.members)]
    members = team_for(program, agents)
    answers = Answers(made, team, ways(program), {member.id: member.number for member in members})

    def queries() -> list[float]:
        desk = Desk(answers=answers)
        machine = Machine(program, members, 0, desk, SystemClock())
        machine.start(members[0], Limits(heap=1 << 24), generation=1)
        while machine.run() is not None:
            pass
        if desk.endings[0].ended == "died":
            raise RuntimeError(desk.endings[0].report)
        return [float(line) for line in desk.output]

    queries()
    return queries

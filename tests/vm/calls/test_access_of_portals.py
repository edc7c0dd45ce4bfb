"""A forbidden portal call never begins: directly, after a hop, and in a composed offer."""

from __future__ import annotations

import random
from functools import cache
from pathlib import Path

import pytest

from lfield.bytecode.program import Program
from lfield.capability.model import Registry
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.clock import ManualClock
from lfield.testing.golden import GoldenWorld, compile_text, run_until_idle, team_for
from lfield.testing.still_team import still_answers
from lfield.vm.agent import MachineTeam, TeamMember
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.machine import Machine

STORES = """
resource Store {
  int kept;
  init(string[] arg) { %s }
  portal add(int n) emit int { print("began"); kept = kept + n; return kept; }
  portal total() emit int { print("began"); return kept; }
}
coordinator Clerk {
  Store near; Store far;
  init(string[] arg) {
    near = findStore("near"); far = findStore("far");
    try { print(near.total()); print(far.total()); } catch (AccessException e) {
      print(e.source() + ": " + e.message());
    }
    print(near.add(2));
    far.add(1);
  }
}
"""
TEAM = [
    TeamMember(0, "near", "Store", "resource", 0),
    TeamMember(1, "far", "Store", "resource", 1),
    TeamMember(2, "clerk", "Clerk", "coordinator", 0),
]
LIFTING = Path(__file__).parents[2] / "golden" / "programs" / "lifting.yaml"


class Ruled:
    """Refuses some calls (`coordinator resource.portal`), and records the requests."""

    def __init__(self, *refused: str) -> None:
        self.refused = refused
        self.asked: list[str] = []
        self.program: Program

    def __call__(self, coordinator: str, resource: str, method: int) -> str:
        call = f"{coordinator} {resource}.{self.program.core.methods[method].name}"
        self.asked.append(call)
        return f"no {call}" if call in self.refused else ""


@cache
def stores(opening: str) -> Program:
    return compile_text(STORES % opening)


def clerk(rules: Ruled | None, opening: str = "") -> list[str]:
    """The output on the two hosts of the clerk."""
    clock, desks, machines = ManualClock(), (GoldenWorld(), GoldenWorld()), []
    if rules is not None:
        rules.program = stores(opening)
    for host, desk in enumerate(desks):
        machine = desk.machine = Machine(
            stores(opening), MachineTeam(TEAM, host, 1 + host), desk, clock, random.Random(1)
        )
        machine.hooks.rules = rules
        machine.start(TEAM[host], AgentLimits(), 0)
        machines.append(machine)
    machines[0].start(TEAM[2], AgentLimits(), 1)
    for _ in range(20):
        for machine in machines:
            run_until_idle(machine, clock)
        leaving = next((i for i, desk in enumerate(desks) if desk.departures), None)
        if leaving is None:
            break
        agent, _ = desks[leaving].departures.pop()
        image = bytes(machines[leaving].pack(agent))
        machines[leaving].release(agent)
        machines[1 - leaving].unfreeze(machines[1 - leaving].inject(TEAM[2], image, AgentLimits()))
    (ended,) = (agent for desk in desks for agent in desk.endings)
    return [*(line for desk in desks for line in desk.output), ended.report.partition("\n")[0]]


def test_without_rules_every_call_begins() -> None:
    assert clerk(None) == ["began", "0", "began", "2", "began", "0", "began", ""]


@pytest.mark.parametrize("opening", ["", "sleep(1.0);"], ids=["open", "opening"])
def test_a_refused_portal_has_not_begun_and_its_caller_can_continue(opening: str) -> None:
    rules = Ruled("clerk near.total", "clerk far.add")
    output = clerk(rules, opening)
    assert output == [
        "near: no clerk near.total",
        "began",
        "2",
        "AccessException: no clerk far.add",
    ]
    assert rules.asked[-1] == "clerk far.add"


def test_the_host_of_the_resource_checks_the_call_after_the_hop() -> None:
    rules = Ruled("clerk far.total")
    output = clerk(rules)
    assert "far: no clerk far.total" in output
    assert rules.asked == ["clerk near.total", "clerk far.total", "clerk near.add", "clerk far.add"]


COMPOSED = """
resource Copter {
    init(string[] arg) { while (true) yield(); }
    portal climb(real height) emit real { print("climbs"); return height; }
    portal stop() { print("stops"); }
}
resource Claw {
    boolean held;
    init(string[] arg) { while (true) yield(); }
    portal grip() emit boolean { print("grips"); held = !held; return held; }
}
coordinator Boss {
    init(string[] arg) {
        Lift[] who = findLift();
        try { who[0].lift(1.0); } catch (AccessException e) { print(e.source() + ": " + e.message()); }
        who[0].stop();
    }
}
"""


@pytest.fixture(scope="module")
def lifting() -> Registry:
    return read_registry([LIFTING])


@pytest.mark.parametrize(
    ("refused", "said"),
    [
        ("", ["grips", "climbs", "stops"]),
        ("boss claw.grip", ["claw: no boss claw.grip", "stops"]),
        ("boss weak.climb", ["grips", "weak: no boss weak.climb", "stops"]),
    ],
)
def test_each_portal_of_a_composed_offer_is_checked(lifting: Registry, refused: str, said: list[str]) -> None:
    rules, desk, clock = Ruled(refused), GoldenWorld(), ManualClock()
    program = rules.program = compile_text(COMPOSED, registry=lifting)
    team = team_for(program, [("Copter", "weak", ""), ("Claw", "claw", ""), ("Boss", "boss", "")])
    desk.answers = still_answers(lifting, program, team)
    machine = desk.machine = Machine(program, MachineTeam(team, 0, 1), desk, clock, random.Random(1))
    machine.hooks.rules = rules
    for member in team:
        machine.start(member, AgentLimits(), generation=1)
    run_until_idle(machine, clock)
    assert desk.output == said

"""A team of any size on many hosts, as the first of them knows it: for the figures of growth.

Ten agents are on each host. The coordinator, its machine, the directory, the reports of the other hosts and
the matcher are those of a host that runs; only devices and links are not there, and time stands still unless
it is moved. In a lively team every agent has four live values, and all of them are new at each question.
"""

from __future__ import annotations

import random
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from lfield.capability.condition_compiler import compile_query
from lfield.capability.directory.directory_delta import (
    AgentCondition,
    AttributeSample,
    DirectoryDelta,
    Unavailability,
)
from lfield.capability.matching.matcher import Matcher
from lfield.capability.model import ANY_OFFER
from lfield.clock import ManualClock
from lfield.host.context import HostContext
from lfield.host.events.event_recorder import EventRecorder
from lfield.host.offer_queries import CapabilityQueries
from lfield.host.team_directory import TeamDirectory
from lfield.manifest import Observation
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.operator.team_query import roster_from_hosts
from lfield.replication.membership.overlay import Overlay
from lfield.testing.golden import GoldenWorld
from lfield.vm.agent import Agent, MachineTeam
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.machine import Machine
from lfield.vm.memory.collector import collect
from lfield.vm.offer_objects import FoundOffer

#: How an offer comes about, with the resource types that a team needs for it; and proxies, without offers.
KINDS: Mapping[str, Sequence[str]] = {
    "Crane": ("Crane",),
    "Direct": ("Crane",),
    "Equal": ("Copter",),
    "Pair": ("Copter", "Hand"),
    "Trio": ("Copter", "Hand", "Cart"),
    "Team": ("Crane",),
}
#: The one of proxies, and the one of teams of two that offer `Direct`.
PROXIES, TEAMS = "Crane", "Team"
#: About half of all agents fulfil it.
CONDITION = "payload >= 4.0 && battery >= 0.1 && mass < 99.0"
PER_HOST = 10
#: Nobody is in the middle of anything: what is measured may take as long as it does.
_LIMITS = AgentLimits(heap=1 << 24)

_RESOURCE = """
resource %s {
    Mavlink fc;

    init(string[] arg) { }
    portal %s() { }
}
"""
_PORTALS = {"Crane": "direct", "Copter": "rise", "Hand": "hold", "Cart": "roll"}
_BOSS = """
coordinator Boss {
    init(string[] arg) {
        while (true) {
            %s[] who = null;
            if (arg.length() == 1) who = %s; else who = %s;
            print(who.length());
            sleep(1.0);
        }
    }
}
"""
_LIVE = "live: {battery: fc.battery, north: 'fc.position[0]', east: 'fc.position[1]', down: 'fc.position[2]'}"
_REGISTRY = """
registry: 1
taxonomy:
  skill.direct: {meaning: done by one}
  skill.equal: {meaning: done by one of another kind}
  skill.rise: {meaning: what it does instead}
  skill.clutch: {meaning: the second part}
  skill.roll: {meaning: the third part}
  skill.pair: {meaning: done by two}
  skill.trio: {meaning: done by three}
primitives:
  Direct: {id: skill.direct, portals: {direct: {}}}
  Equal: {id: skill.equal, portals: {equal: {}}}
  Rise: {id: skill.rise, portals: {rise: {}}}
  Clutch: {id: skill.clutch, portals: {hold: {}}}
  Roll: {id: skill.roll, portals: {roll: {}}}
  Pair: {id: skill.pair, portals: {pair: {}}}
  Trio: {id: skill.trio, portals: {trio: {}}}
providers:
  Crane: {LIVE serves: {Direct: {}}}
  Copter: {LIVE serves: {Rise: {}}}
  Hand: {LIVE serves: {Clutch: {}}}
  Cart: {LIVE serves: {Roll: {}}}
equivalences:
  rise-equals: {serves: Equal, by: Rise, portals: {equal: rise}, loss: 0.3}
  two-parts:
    serves: Pair
    needs: {sky: {capability: Rise}, hand: {capability: Clutch}}
    where: ["sky.agent != hand.agent"]
    through: TwoParts
    source: parts.L
    attributes: {payload: "min(sky.payload, hand.payload)", battery: sky.battery, mass: hand.mass}
  three-parts:
    serves: Trio
    needs: {sky: {capability: Rise}, hand: {capability: Clutch}, cart: {capability: Roll}}
    where: ["sky.agent != hand.agent"]
    through: ThreeParts
    source: parts.L
    attributes: {payload: "min(sky.payload, hand.payload)", battery: cart.battery, mass: hand.mass}
agents:
"""
_PARTS = """
class TwoParts coordinator specific {
    public TwoParts(Rise sky, Clutch hand) { }
    public void pair() { }
}
class ThreeParts coordinator specific {
    public ThreeParts(Rise sky, Clutch hand, Roll cart) { }
    public void trio() { }
}
"""


@cache
def growing_mission(kind: str, count: int, lively: bool) -> Mission:
    """So many agents of the types of a kind in turn, a boss who asks for it, and one with a condition."""
    with TemporaryDirectory(prefix="lfield-bench-") as folder:
        return _written(Path(folder), kind, count, lively)


def _written(folder: Path, kind: str, count: int, lively: bool) -> Mission:
    types, chance = KINDS[kind], random.Random(1)
    resources = (_RESOURCE % (name, portal) for name, portal in _PORTALS.items())
    (folder / "team.L").write_text("".join(resources) + _BOSS % _asked(kind))
    (folder / "parts.L").write_text(_PARTS)
    rows = [f"//{types[i % len(types)]}:a{i}@host{i // PER_HOST}" for i in range(count)]
    (folder / "team.dL").write_text(
        "\n".join([*rows, "//Boss:boss@host0", "//Boss:chooser@host0?wished", ""])
    )
    own = "  a%d: {payload: %.2f, mass: %.2f%s}\n"
    battery = "" if lively else ", battery: 0.9"
    stated = "".join(own % (i, chance.uniform(1, 9), chance.uniform(5, 50), battery) for i in range(count))
    registry = _REGISTRY.replace("LIVE", f"{_LIVE}," if lively else "")
    (folder / "team.capabilities.yaml").write_text(registry + stated)
    return load_mission(folder / "team.dL", simulate=True)


def _asked(kind: str) -> tuple[str, str, str]:
    """The elements of the answer, and how is asked for it, without and with a condition."""
    if kind == PROXIES:
        return kind, f"find{kind}()", f"find{kind}()"
    if kind == TEAMS:
        return "Direct[]", "teamsDirect(2)", f'teamsDirect("{CONDITION}", 2)'
    return kind, f"find{kind}()", f'find{kind}("{CONDITION}")'


@dataclass
class Nearby:
    """The devices of the first host, which always tell something new, and links that hold."""

    clock: ManualClock
    chance: random.Random
    down_since: Mapping[str, float] = field(default_factory=dict)

    def last(self, device: str, quantity: str) -> Observation:
        """A value of this moment."""
        number = self.chance.uniform(0.2, 1.0)
        return Observation(number if quantity == "battery" else (number,) * 3, self.clock.monotonic())

    def trouble(self, device: str) -> Unavailability | None:
        """None has any."""
        return None

    def last_contact(self, host: str) -> float:
        """This moment."""
        return self.clock.monotonic()


@dataclass
class Answering(GoldenWorld):
    """What a host answers; its output is kept."""

    offering: CapabilityQueries | None = None

    def offers(self, agent: Agent, capability: str, constraint: str | None) -> list[FoundOffer]:
        """As the world of a host does."""
        assert self.offering is not None
        return self.offering.find_offers(agent.id, capability, constraint)

    def teams(
        self, agent: Agent, capability: str, constraint: str | None, size: int
    ) -> list[list[FoundOffer]]:
        """The same of teams."""
        assert self.offering is not None
        return self.offering.find_teams(agent.id, capability, constraint, size)


class FirstHost:
    """The host of a boss, who asks whenever a second has passed: with a condition if it is `choosy`."""

    def __init__(self, mission: Mission, lively: bool, choosy: bool) -> None:
        self._boss, self._condition = ("chooser", CONDITION) if choosy else ("boss", "")
        self._mission, self._lively = mission, lively
        self._clock, self._chance = ManualClock(), random.Random(2)
        self._desk, self._reported = Answering(), 0
        members = mission.team.members
        self._machine = Machine(
            mission.program, MachineTeam(members, 0, 1), self._desk, self._clock, random.Random(3)
        )
        here = mission.team.hosts[0]
        nearby = Nearby(self._clock, self._chance)
        overlay = Overlay(mission.team.hosts, 0, is_full_mesh=True)
        recorder = EventRecorder(self._clock)
        context = HostContext(
            mission,
            here,
            1,
            self._clock,
            nearby,
            random.Random(4),
            10.0,
            overlay,
            recorder,  # type: ignore[arg-type]
        )
        self._directory = TeamDirectory(context, self._machine, lambda agent: None, nearby)
        self._desk.machine, self._desk.offering = self._machine, CapabilityQueries(self._directory, mission)
        self._others: dict[str, list[str]] = {}
        for agent in mission.team.deployed:
            if agent.host != here and agent.type in self._directory.registry.providers:
                self._others.setdefault(agent.host, []).append(agent.id)
        for host in self._others:
            self._directory.directory.on_link_up(host, 1)
        self._tell()
        for member in mission.team.members_on(0):
            if member.kind == "resource" or member.id == self._boss:
                self._machine.start(member, _LIMITS, generation=1)
                self._machine.run()

    def find(self) -> float:
        """Processor seconds of one question of the boss, with all that its host does for it."""
        self._clock.advance(1.5)
        if self._lively:
            self._tell()
        answers = len(self._desk.output)
        start = time.process_time()
        while len(self._desk.output) == answers:
            self._machine.run()
        return time.process_time() - start

    @property
    def found(self) -> int:
        """How many the boss has found last."""
        return int(self._desk.output[-1])

    def memory(self) -> int:
        """Bytes of what lives in the boss's block, with the answer that it has."""
        block = self._machine.agents[self._boss].block
        collect(block, self._machine.layouts)
        return 8 * block.top

    def query(self, kind: str) -> float:
        """Those of the same question from outside: what `lfield query` does once this host has answered."""
        if self._lively:
            self._tell()
        registry = self._directory.registry
        views = {self._mission.team.hosts[0]: {told.agent: told for told in self._directory.entries()}}
        wish = compile_query(self._condition, registry.attributes) if self._condition else ANY_OFFER
        primitive = "Direct" if kind == TEAMS else kind
        start = time.process_time()
        matcher = Matcher(registry, roster_from_hosts(registry, self._mission.team.deployed, views, ()))
        assert matcher.find(primitive, wish).count
        matcher.explain(primitive, wish.condition)
        if kind == TEAMS:
            assert matcher.teams(primitive, 2, wish).teams
        return time.process_time() - start

    def _tell(self) -> None:
        """The other hosts report all of their agents; of a still team there is nothing to tell."""
        now, before = self._clock.monotonic(), self._reported
        self._reported += 1
        for host, agents in self._others.items():
            conditions = {agent: self._told(agent, now) for agent in agents}
            self._directory.directory.on_delta(host, DirectoryDelta(1, before, self._reported, conditions))

    def _told(self, agent: str, now: float) -> AgentCondition:
        live = self._directory.directory.live(agent)
        return AgentCondition(
            samples={name: AttributeSample(self._chance.uniform(0.2, 1.0), now - 0.05, now) for name in live}
        )

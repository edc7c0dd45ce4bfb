"""An agent as an answer shows it: one way for a host's own directory, and for whoever asks from outside.

What is said of an agent, the surest first: by the mission's registry; by its binding, which its host tells;
by its devices. What its type states comes last, and is added where somebody wants to know what it can do.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol

from lfield.capability.matching.expression import POSITION
from lfield.capability.model import Attribute, Live, Registry
from lfield.capability.offer import Candidate, Fact, Place


class Deployed(Protocol):
    """An agent as the deployment has it."""

    @property
    def id(self) -> str:
        """Its name in the mission."""

    @property
    def type(self) -> str:
        """Its type in L."""

    @property
    def host(self) -> str:
        """Where it lives."""


@dataclass(frozen=True, slots=True)
class Known:
    """What never changes of an agent: its number in the deployment, what the mission states of it, and which
    values must be measured.
    """

    agent: Deployed
    number: int
    stated: Mapping[str, Fact]
    measured: Collection[str]

    def shown(
        self, hops: int, refusal: str, told: Mapping[str, Fact], unknown: Mapping[str, str], untold: str
    ) -> Candidate:
        """The agent with what its host has told of it.

        `untold` is the reason for a value that is neither told nor known to be none, with the name of the
        attribute as `{0}` and the host's as `{1}`.
        """
        if not self.stated.keys().isdisjoint(told):
            told = {name: fact for name, fact in told.items() if name not in self.stated}
        if unknown:
            # Of what need not be measured its type may say what is usual.
            unknown = {name: why for name, why in unknown.items() if name in self.measured}
        lacking = [name for name in self.measured if name not in told and name not in unknown]
        if lacking:
            unknown = {**{name: untold.format(name, self.agent.host) for name in lacking}, **unknown}
        agent, number = self.agent, self.number
        return Candidate(agent.id, agent.type, agent.host, hops, refusal, told, unknown, number, self.stated)


def known_agents(registry: Registry, agents: Collection[Deployed]) -> dict[str, Known]:
    """The agents of a type that the registry knows, by id, in their order."""
    numbered = enumerate(agents)
    return {a.id: _known(registry, a, number) for number, a in numbered if a.type in registry.providers}


def _known(registry: Registry, agent: Deployed, number: int) -> Known:
    stated = {name: Fact(value) for name, value in registry.agents.get(agent.id, {}).items()}
    live = live_attributes(registry, agent)
    return Known(agent, number, stated, tuple(name for name in live if registry.attributes[name].live))


def live_attributes(registry: Registry, agent: Deployed) -> dict[str, Live]:
    """The attributes of an agent that it tells itself, in the order of their names.

    What the mission states of an agent counts before what its devices say.
    """
    stated = registry.agents.get(agent.id, {})
    live = registry.providers[agent.type].live
    return {name: live[name] for name in sorted(live) if name not in stated}


def place_of(
    candidates: Iterable[Candidate], attributes: Mapping[str, Attribute], pose: Place | None = None
) -> Place | None:
    """Where the first of some agents is that tells north and east, and has done so lately.

    Else the `pose` of their host, unless one of them measures its place and does not know it: it has moved.
    """
    for candidate in candidates:
        found = [_fresh(candidate, axis, attributes) for axis in POSITION]
        if found[0] is not None and found[1] is not None:
            return found[0], found[1], found[2]
        if any(axis in candidate.unknown or candidate.fact(axis) for axis in POSITION):
            pose = None
    return pose


def _fresh(candidate: Candidate, name: str, attributes: Mapping[str, Attribute]) -> float | None:
    fact, attribute = candidate.fact(name), attributes.get(name)
    if fact is None or attribute is None or (attribute.live and fact.age > attribute.max_age):
        return None
    known = isinstance(fact.value, int | float) and math.isfinite(fact.value)
    return float(fact.value) if known else None  # type: ignore[arg-type]  # it is a number

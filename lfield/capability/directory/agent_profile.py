"""An agent with its attributes, for a host's directory and for observers.

Sources of attributes, the most reliable first: the mission's registry; its binding, which its host sends;
its devices. The attributes of its type come last, and are added when a primitive is matched.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from typing import Protocol

from msgspec import Struct

from lfield.capability.matching.condition_checker import POSITION
from lfield.capability.model import Attribute, LiveAttribute, Registry
from lfield.capability.offer import Candidate, Fact, Position


class AgentIdentity(Protocol):
    """An agent as in the deployment."""

    @property
    def id(self) -> str:
        """The name of the agent in the mission."""

    @property
    def type(self) -> str:
        """The type of the agent in L."""

    @property
    def host(self) -> str:
        """The host of the agent."""


class AgentProfile(Struct, frozen=True):
    """The constant data of an agent: its number in the deployment, its attributes stated by the mission,
    and the attributes that must be measured.
    """

    agent: AgentIdentity
    number: int
    stated: Mapping[str, Fact]
    measured: Collection[str]

    def candidate(
        self,
        hops: int,
        refusal: str,
        reported: Mapping[str, Fact],
        unknown: Mapping[str, str],
        unreported: str,
    ) -> Candidate:
        """The agent with the values received from its host.

        `unreported` is the reason for a value that is neither received nor known to be missing, with the name
        of the attribute as `{0}` and the host's as `{1}`.
        """
        if not self.stated.keys().isdisjoint(reported):
            reported = {name: fact for name, fact in reported.items() if name not in self.stated}
        if unknown:
            # The type may have usual values of attributes that are not measured.
            unknown = {name: reason for name, reason in unknown.items() if name in self.measured}
        lacking = [name for name in self.measured if name not in reported and name not in unknown]
        if lacking:
            unknown = {**{name: unreported.format(name, self.agent.host) for name in lacking}, **unknown}
        agent, number = self.agent, self.number
        return Candidate(
            agent.id, agent.type, agent.host, hops, refusal, reported, unknown, number, self.stated
        )


def agent_profiles(registry: Registry, agents: Collection[AgentIdentity]) -> dict[str, AgentProfile]:
    """The agents of a type of the registry, by id, in their order."""
    numbered = enumerate(agents)
    return {a.id: _profile(registry, a, number) for number, a in numbered if a.type in registry.providers}


def _profile(registry: Registry, agent: AgentIdentity, number: int) -> AgentProfile:
    stated = {name: Fact(value) for name, value in registry.agents.get(agent.id, {}).items()}
    live = live_attributes(registry, agent)
    return AgentProfile(agent, number, stated, tuple(name for name in live if registry.attributes[name].live))


def live_attributes(registry: Registry, agent: AgentIdentity) -> dict[str, LiveAttribute]:
    """The attributes that an agent reports, in the order of their names.

    Values stated by the mission take precedence over those of devices.
    """
    stated = registry.agents.get(agent.id, {})
    live = registry.providers[agent.type].live
    return {name: live[name] for name in sorted(live) if name not in stated}


def location_of(
    candidates: Iterable[Candidate], attributes: Mapping[str, Attribute], pose: Position | None = None
) -> Position | None:
    """The position of the first of some agents that has reported north and east recently.

    Else the `pose` of their host, unless an agent that measures its position does not know it: the agent may
    have moved.
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

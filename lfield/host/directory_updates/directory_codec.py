"""Encodes and decodes directory updates: names become indexes, times become ages.

Both sides have the same deployment and the same registry, so the indexes agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from lfield.capability.directory.agent_profile import AgentIdentity
from lfield.capability.directory.directory_delta import (
    AgentCondition,
    AttributeSample,
    DirectoryDelta,
    ReservedBy,
    Unavailability,
)
from lfield.capability.model import Attribute, Registry, Value
from lfield.capability.offer import Provenance
from lfield.errors import WireError
from lfield.wire.fields import MAX_LABEL, FactValue, ValueSource, bounded_duration, truncate
from lfield.wire.messages import AgentUpdate, AttributeUpdate, DirectoryUpdate


class DirectoryCodec:
    """The codec of a mission; `agents` in the order of the deployment."""

    def __init__(self, registry: Registry, agents: Sequence[AgentIdentity]) -> None:
        self._agents, self._providers = agents, registry.providers
        self._numbers = {agent.id: number for number, agent in enumerate(agents)}
        self._attributes = [attribute for _, attribute in sorted(registry.attributes.items())]
        self._places = {attribute.name: place for place, attribute in enumerate(self._attributes)}

    def encode(self, delta: DirectoryDelta, now: float) -> DirectoryUpdate:
        """The update with this host's changes; `now` is its monotonic clock."""
        agents = [self._encode_agent(agent, change, now) for agent, change in delta.agents.items()]
        return DirectoryUpdate(delta.incarnation, delta.since, delta.sequence, agents)

    def _encode_agent(self, agent: str, change: AgentCondition, now: float) -> AgentUpdate:
        places, unavailability = self._places, change.unavailability
        since = None if unavailability is None else unavailability.since
        lasting = None if since is None else bounded_duration(now - since)
        facts = [
            AttributeUpdate(
                places[name],
                sorted(s.value) if isinstance(s.value, frozenset) else s.value,
                bounded_duration((s.at if s.is_kept_current else now) - s.when),
                s.is_kept_current,
                value_source(s.of),
            )
            for name, s in change.samples.items()
        ]
        unknown = [(places[name], truncate(text, MAX_LABEL)) for name, text in change.unknown.items()]
        reason = truncate(unavailability.reason, MAX_LABEL) if unavailability else ""
        holder, reserved_for = (
            ("", 0.0) if (r := change.reserved) is None else (r.holder, bounded_duration(now - r.since))
        )
        return AgentUpdate(self._numbers[agent], reason, lasting, facts, unknown, holder, reserved_for)

    def decode(self, host: str, report: DirectoryUpdate, now: float) -> DirectoryDelta:
        """The changes of a host. Raises WireError for changes of agents of other hosts."""
        agents: dict[str, AgentCondition] = {}
        for entry in report.agents:
            agent = self._agents[entry.agent] if entry.agent < len(self._agents) else None
            if agent is None or agent.host != host or agent.type not in self._providers:
                raise WireError(f"{host} reports on agent {entry.agent}, which is none of its")
            agents[agent.id] = self._decode_agent(agent, entry, now)
        return DirectoryDelta(report.incarnation, report.since, report.sequence, agents)

    def _decode_agent(self, deployed: AgentIdentity, update: AgentUpdate, now: float) -> AgentCondition:
        agent, live = deployed.id, self._providers[deployed.type].live
        since = None if update.lasting is None else now - update.lasting
        unavailability = Unavailability(update.trouble, since) if update.trouble else None
        samples: dict[str, AttributeSample] = {}
        for fact in update.facts:
            attribute = self._attribute(agent, fact.attribute)
            if fact.of != "stated" and attribute.name not in live:
                raise WireError(f"a report has {attribute.name} {fact.of}, which {agent} does not report")
            value = _value(agent, attribute, fact.value)
            samples[attribute.name] = AttributeSample(value, now - fact.age, now, fact.kept, fact.of)
        unknown = {self._attribute(agent, place).name: reason for place, reason in update.unknown}
        reserved = ReservedBy(update.holder, now - update.held) if update.holder else None
        return AgentCondition(unavailability, samples, unknown, reserved)

    def _attribute(self, agent: str, place: int) -> Attribute:
        known = self._attributes
        if place >= len(known):
            raise WireError(f"a report names attribute {place} of {agent}, and there are {len(known)}")
        return known[place]


def value_source(provenance: Provenance) -> ValueSource:
    """The provenance of a value as encoded; the usual provenance of a type is omitted."""
    return "stated" if provenance == "nominal" else provenance


def _value(agent: str, attribute: Attribute, value: FactValue) -> Value:
    """A received value, converted to the type of its attribute. Raises WireError."""
    match attribute.type:
        case "boolean" if isinstance(value, bool):
            return value
        case "int" if isinstance(value, int) and not isinstance(value, bool):
            return value
        case "real" if isinstance(value, float) and math.isfinite(value):
            return value
        case "text" if isinstance(value, str):
            return value
        case "set" if isinstance(value, list):
            return frozenset(value)
    raise WireError(
        f"a report says {value!r} for {attribute.name} of {agent}, whose type is {attribute.type}"
    )

"""News of the directory as messages and back: names are numbers on the way, times are ages.

Both sides have the same deployment and the same registry, so they count agents and attributes alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from lfield.capability.directory.news import Condition, News, Reserved, Sample, Trouble
from lfield.capability.directory.showing import Deployed
from lfield.capability.model import Attribute, Registry, Value
from lfield.capability.offer import Provenance
from lfield.errors import WireError
from lfield.wire.fields import MAX_LABEL, FactValue, ToldBy, age, clip
from lfield.wire.messages import AgentReport, FactReport, Report


class Reports:
    """Writes and reads the reports of a mission; `agents` in the order of the deployment."""

    def __init__(self, registry: Registry, agents: Sequence[Deployed]) -> None:
        self._agents, self._providers = agents, registry.providers
        self._numbers = {agent.id: number for number, agent in enumerate(agents)}
        self._attributes = [attribute for _, attribute in sorted(registry.attributes.items())]
        self._places = {attribute.name: place for place, attribute in enumerate(self._attributes)}

    def write(self, news: News, now: float) -> Report:
        """The report of this host's news; `now` is its monotonic clock."""
        agents = [self._write_agent(agent, change, now) for agent, change in news.agents.items()]
        return Report(news.life, news.since, news.sequence, agents)

    def _write_agent(self, agent: str, change: Condition, now: float) -> AgentReport:
        places, trouble = self._places, change.trouble
        lasting = None if trouble is None or trouble.since is None else age(now - trouble.since)
        facts = [
            FactReport(
                places[name],
                sorted(s.value) if isinstance(s.value, frozenset) else s.value,
                age((s.at if s.kept else now) - s.when),
                s.kept,
                said(s.of),
            )
            for name, s in change.samples.items()
        ]
        unknown = [(places[name], clip(why, MAX_LABEL)) for name, why in change.unknown.items()]
        reason = clip(trouble.reason, MAX_LABEL) if trouble else ""
        holder, held = ("", 0.0) if (r := change.reserved) is None else (r.holder, age(now - r.since))
        return AgentReport(self._numbers[agent], reason, lasting, facts, unknown, holder, held)

    def read(self, host: str, report: Report, now: float) -> News:
        """The news of a host. Raises WireError for what that host cannot say."""
        agents: dict[str, Condition] = {}
        for told in report.agents:
            agent = self._agents[told.agent] if told.agent < len(self._agents) else None
            if agent is None or agent.host != host or agent.type not in self._providers:
                raise WireError(f"{host} reports on agent {told.agent}, which is none of its")
            agents[agent.id] = self._read_agent(agent, told, now)
        return News(report.life, report.since, report.sequence, agents)

    def _read_agent(self, deployed: Deployed, told: AgentReport, now: float) -> Condition:
        agent, live = deployed.id, self._providers[deployed.type].live
        since = None if told.lasting is None else now - told.lasting
        trouble = Trouble(told.trouble, since) if told.trouble else None
        samples: dict[str, Sample] = {}
        for fact in told.facts:
            attribute = self._attribute(agent, fact.attribute)
            if fact.of != "stated" and attribute.name not in live:
                raise WireError(f"a report has {attribute.name} {fact.of}, which nothing of {agent} tells")
            value = _value(agent, attribute, fact.value)
            samples[attribute.name] = Sample(value, now - fact.age, now, fact.kept, fact.of)
        unknown = {self._attribute(agent, place).name: why for place, why in told.unknown}
        reserved = Reserved(told.holder, now - told.held) if told.holder else None
        return Condition(trouble, samples, unknown, reserved)

    def _attribute(self, agent: str, place: int) -> Attribute:
        known = self._attributes
        if place >= len(known):
            raise WireError(f"a report names attribute {place} of {agent}, and there are {len(known)}")
        return known[place]


def said(of: Provenance) -> ToldBy:
    """Where a value is from, as a host tells it: what is usual of a type nobody has to tell."""
    return "stated" if of == "nominal" else of


def _value(agent: str, attribute: Attribute, value: FactValue) -> Value:
    """A value that came, as one of its attribute. Raises WireError."""
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
    raise WireError(f"a report says {value!r} for {attribute.name} of {agent}, which is no {attribute.type}")

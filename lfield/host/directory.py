"""How the agents of the team are: this host looks at its own, tells the others, and hears from them.

Every host looks at its agents once in LOOK_EVERY seconds and tells the others what has changed, in one
message for all agents. A host that is linked anew is told everything once. In a program that names no
capability of a registry nothing of all this happens: of agents that no registry knows it is looked up what
this host knows anyway, when somebody asks.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from msgspec.structs import replace

from lfield.capability.directory.directory import Directory, Links
from lfield.capability.directory.news import News, Reserved, Trouble
from lfield.capability.model import Registry
from lfield.capability.offer import Candidate, Fact
from lfield.clock import Clock
from lfield.errors import WireError
from lfield.host.telling.asking import Asking, Machine
from lfield.host.telling.reports import Reports, said
from lfield.host.telling.sampling import Devices, Sampler
from lfield.mission.mission import Mission
from lfield.mission.team import Deployed
from lfield.mobility.effects import Send
from lfield.wire.fields import age, clip
from lfield.wire.messages import Hello, Report
from lfield.wire.observing import Told, ToldFact

#: The registry of a mission that asks for no capability.
NO_REGISTRY = Registry({}, {}, {}, {}, {}, {})

#: Seconds between two looks at the devices of this host for the others' sake.
LOOK_EVERY = 1.0


class Neighbours(Devices, Links, Protocol):
    """What a directory may look at: the devices of this host, and its links."""


class TeamDirectory:
    """Keeps the `directory` of a host up to date. Only agents that the `registry` knows are in it; whether
    the other resources of the team can be called is asked of their devices here, and of the links.

    `life` tells this run of the host from the next, `machine` runs its agents. What is to be told to others
    comes back as messages to send.
    """

    def __init__(
        self,
        mission: Mission,
        name: str,
        life: int,
        machine: Machine,
        nearby: Neighbours,
        clock: Clock,
    ) -> None:
        self.registry = registry = mission.stated or NO_REGISTRY
        agents = mission.team.deployed
        self._here, self._nearby, self._clock = name, nearby, clock
        pose = mission.bindings.frames.place(name)
        self.directory = Directory(registry, agents, name, nearby, clock, life, pose)
        others = {each.id for each in mission.team.members if each.kind == "resource"}
        #: The resources that no registry knows.
        self._others = [a for a in agents if a.id in others and a.type not in registry.providers]
        self._reports = Reports(registry, agents)
        fields = {agent.id: mission.bindings.devices.get(agent.id, {}) for agent in agents}
        bound = mission.bindings.attributes
        self._asking = Asking(machine, clock)
        self._sampler = Sampler(
            registry.attributes, machine.agents, fields, nearby, self._asking, clock, bound
        )
        self._linked: dict[str, None] = {}
        #: Who has reserved an agent of this host.
        self.reserved: Callable[[str], Reserved | None] = lambda agent: None
        #: When `tick` has something to do next, None for never.
        self.due: float | None = None

    def open(self) -> None:
        """Begin to look at this host's agents, if there are any to tell of."""
        if self.directory.own_agents:
            self.due = self._clock.monotonic()

    def linked(self, hello: Hello) -> list[Send]:
        """A host can be talked to: it is told everything, since it may have been away."""
        self._linked[hello.host] = None
        self.directory.linked(hello.host, hello.incarnation)
        news = self.directory.everything()
        return [] if news is None else [Send(hello.host, self._report(news))]

    def unlinked(self, host: str) -> None:
        """A host cannot be talked to any more."""
        self._linked.pop(host, None)
        self.directory.unlinked(host)

    def received(self, host: str, report: Report) -> str:
        """A host tells how its agents are. A report that cannot be is left out: the complaint, else ''."""
        try:
            self.directory.take(host, self._reports.read(host, report, self._clock.monotonic()))
        except WireError as error:
            return f"ignored a report: {error}"
        return ""

    def tick(self, now: float) -> list[Send]:
        """It is time to look at this host's agents, and to tell the others what has changed."""
        self.due = now + LOOK_EVERY
        self.look()
        news = self.directory.news()
        if news is None:
            return []
        report = self._report(news)
        return [Send(host, report) for host in self._linked]

    def look(self) -> None:
        """Bring what the directory knows of this host's agents up to date."""
        for agent in self.directory.own_agents:
            live = self.directory.live(agent)
            self._asking.look(agent, live.values())
            condition, held = self._sampler.condition(agent, live), self.reserved(agent)
            self.directory.own(agent, condition if held is None else replace(condition, reserved=held))

    def _report(self, news: News) -> Report:
        return self._reports.write(news, self._clock.monotonic())

    def refusals(self) -> dict[str, str]:
        """Why each resource of the team cannot be called, '' when it can, as it was at the last look."""
        self.directory.asker = ""
        known = {candidate.agent: candidate.refusal for candidate in self.directory.everybody()}
        return known | {agent.id: self._refusal(agent) for agent in self._others}

    def _refusal(self, agent: Deployed) -> str:
        """Why a resource that no registry knows cannot be called, as far as this host knows."""
        if agent.host == self._here:
            why = self._sampler.trouble(agent.id) or self.reserved(agent.id)
        else:
            since = self._nearby.away.get(agent.host)
            why = None if since is None else Trouble("unreachable", since)
        return "" if why is None else why.sentence(self._clock.monotonic())

    def told(self) -> list[Told]:
        """For whoever asks from outside: how every resource is now."""
        self.look()
        self.directory.asker = ""
        known = [self._told(candidate) for candidate in self.directory.everybody()]
        return known + [Told(agent.id, clip(self._refusal(agent)), {}, {}) for agent in self._others]

    def _told(self, candidate: Candidate) -> Told:
        own = self.registry.agents.get(candidate.agent, {})
        facts = {name: _told(fact) for name, fact in candidate.facts.items() if name not in own}
        unknown = {name: clip(why) for name, why in candidate.unknown.items()}
        return Told(candidate.agent, clip(candidate.refusal), facts, unknown)


def _told(fact: Fact) -> ToldFact:
    value = sorted(fact.value) if isinstance(fact.value, frozenset) else fact.value
    return ToldFact(value, age(fact.age), said(fact.of))

"""Directory of the team's agents: a host samples its own, reports them, and receives the reports of others.

Every SAMPLE_EVERY seconds a host samples its agents and sends the changes, in one message for all agents.
A newly linked host receives the whole directory once. A program without capabilities of a registry needs no
samples: the condition of agents outside a registry is derived on demand from the data of this host.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

from msgspec.structs import replace

from lfield.capability.directory.agent_directory import AgentDirectory, ContactTimes
from lfield.capability.directory.directory_delta import DirectoryDelta, ReservedBy, Unavailability
from lfield.capability.model import Registry
from lfield.capability.offer import Candidate, Fact
from lfield.errors import WireError
from lfield.host.context import HostContext, LinkClosed, LinkOpened, Part
from lfield.host.directory_updates.agent_sampler import AgentSampler
from lfield.host.directory_updates.attribute_poller import AttributePoller, PolledMachine
from lfield.host.directory_updates.directory_codec import DirectoryCodec, value_source
from lfield.host.effects import WriteLogOnce
from lfield.mission.access.access_rules import DeniedPrimitives
from lfield.mission.team import DeployedMember
from lfield.replication.transfer.effects import Send
from lfield.text import log_messages
from lfield.wire.fields import bounded_duration, truncate
from lfield.wire.messages import DirectoryUpdate
from lfield.wire.observer_messages import AttributeReading, DirectoryEntry

#: The registry of a mission without capabilities.
NO_REGISTRY = Registry({}, {}, {}, {}, {}, {})

#: Seconds between two samples of this host's devices for reports.
SAMPLE_EVERY = 1.0


class TeamDirectory(Part):
    """Keeps the `directory` of a host up to date. Only agents in the `registry` are in it; the devices here
    and the links determine whether other resources of the team can be called.

    `machine` runs the agents of this host, `holder_of` returns the holder of a reservation. `liveness` is the
    membership of the team.
    """

    def __init__(
        self,
        context: HostContext,
        machine: PolledMachine,
        holder_of: Callable[[str], ReservedBy | None],
        liveness: ContactTimes,
    ) -> None:
        mission, name, clock = context.mission, context.name, context.clock
        self._out, self._holder_of = context.effects.append, holder_of
        self.registry = registry = mission.stated or NO_REGISTRY
        #: A mission without capabilities has no agents in the directory.
        agents = mission.team.deployed if registry.providers else ()
        self._mission = mission
        self._own_host, self._liveness, self._clock = name, liveness, clock
        pose = mission.bindings.frames.place(name)
        self.directory = AgentDirectory(registry, agents, name, liveness, clock, context.incarnation, pose)
        self._codec = DirectoryCodec(registry, agents)
        bindings, devices = mission.bindings, context.environment
        self._poller = AttributePoller(machine, clock)
        self._sampler = AgentSampler(
            registry.attributes,
            machine.agents,
            bindings.devices,
            devices,
            self._poller,
            clock,
            bindings.attributes,
        )
        self._linked: dict[str, None] = {}
        if mission.access.callers:
            self.directory.restrict(DeniedPrimitives(mission.access, mission.team.members, registry))
        self.handles = {DirectoryUpdate: self._on_update}
        self.observes = {LinkOpened: self._on_link_opened, LinkClosed: self._on_link_closed}

    @cached_property
    def _others(self) -> list[DeployedMember]:
        """The resources outside the registry."""
        team, providers = self._mission.team, self.registry.providers
        resources = {each.id for each in team.members if each.kind == "resource"}
        return [a for a in team.deployed if a.id in resources and a.type not in providers]

    def open(self) -> None:
        """Start sampling this host's agents, if there are any to report."""
        if self.directory.own_agents:
            self.due = self._clock.monotonic()

    def _on_link_opened(self, event: LinkOpened) -> None:
        """The host gets the whole directory, since it may have been disconnected."""
        hello = event.hello
        self._linked[hello.host] = None
        self.directory.on_link_up(hello.host, hello.incarnation)
        delta = self.directory.full_delta()
        if delta is not None:
            self._out(Send(hello.host, self._report(delta)))

    def _on_link_closed(self, event: LinkClosed) -> None:
        self._linked.pop(event.host, None)
        self.directory.on_link_down(event.host)

    def _on_update(self, host: str, report: DirectoryUpdate) -> None:
        """A host reports its agents. An invalid report is ignored."""
        try:
            self.directory.on_delta(host, self._codec.decode(host, report, self._clock.monotonic()))
        except WireError as error:
            self._out(WriteLogOnce(log_messages.REPORT_INVALID.line(reason=error)))

    def on_tick(self, now: float) -> None:
        """Sample this host's agents, and report the changes."""
        self.due = now + SAMPLE_EVERY
        self.refresh()
        delta = self.directory.next_delta()
        if delta is not None:
            report = self._report(delta)
            for host in self._linked:
                self._out(Send(host, report))

    def refresh(self) -> None:
        """Update the directory with this host's agents."""
        for agent in self.directory.own_agents:
            live = self.directory.live(agent)
            self._poller.poll(agent, live.values())
            condition, held = self._sampler.condition(agent, live), self._holder_of(agent)
            self.directory.set_own(agent, condition if held is None else replace(condition, reserved=held))

    def _report(self, delta: DirectoryDelta) -> DirectoryUpdate:
        return self._codec.encode(delta, self._clock.monotonic())

    def refusals(self) -> dict[str, str]:
        """The reason why each resource of the team cannot be called, '' if it can, as of the last sample."""
        self.directory.answer_for("")
        known = {candidate.agent: candidate.refusal for candidate in self.directory.all_candidates()}
        return known | {agent.id: self._refusal(agent) for agent in self._others}

    def _refusal(self, agent: DeployedMember) -> str:
        """The reason why a resource outside the registry cannot be called, as far as this host knows."""
        if agent.host == self._own_host:
            unavailability = self._sampler.unavailability(agent.id) or self._holder_of(agent.id)
        else:
            since = self._liveness.down_since.get(agent.host)
            unavailability = None if since is None else Unavailability("unreachable", since)
        return "" if unavailability is None else unavailability.sentence(self._clock.monotonic())

    def entries(self) -> list[DirectoryEntry]:
        """The condition of every resource as of the last `refresh`, for observers."""
        self.directory.answer_for("")
        known = [self._entry(candidate) for candidate in self.directory.all_candidates()]
        return known + [
            DirectoryEntry(agent.id, truncate(self._refusal(agent)), {}, {}) for agent in self._others
        ]

    def _entry(self, candidate: Candidate) -> DirectoryEntry:
        own = self.registry.agents.get(candidate.agent, {})
        facts = {name: _attribute_reading(fact) for name, fact in candidate.facts.items() if name not in own}
        unknown = {name: truncate(reason) for name, reason in candidate.unknown.items()}
        return DirectoryEntry(candidate.agent, truncate(candidate.refusal), facts, unknown)


def _attribute_reading(fact: Fact) -> AttributeReading:
    value = sorted(fact.value) if isinstance(fact.value, frozenset) else fact.value
    return AttributeReading(value, bounded_duration(fact.age), value_source(fact.of))

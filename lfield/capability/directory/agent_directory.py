"""The directory of all agents of a mission on one host: their attributes, and whether they can be called.

The agents and their stated values come from the deployment and the registry, the live values of own agents
from this host, and those of other agents from the deltas of their hosts. Queries are answered from these data
alone.

The age of a live value of another host is the reported age plus the time since the last message of that host:
while the link is up and no delta arrives, the value has not changed. Values that a host no longer renews, and
all values of an unreachable host until its next full report, grow older.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Protocol

from msgspec import Struct, field
from msgspec.structs import replace

from lfield.capability.directory.agent_profile import (
    AgentIdentity,
    agent_profiles,
    live_attributes,
    location_of,
)
from lfield.capability.directory.directory_delta import (
    UNCHANGED,
    AgentCondition,
    AttributeSample,
    DeltaEncoder,
    DirectoryDelta,
    Unavailability,
)
from lfield.capability.model import LiveAttribute, Registry
from lfield.capability.offer import Candidate, Fact, Position
from lfield.clock import Clock

#: Answers within this time (s) are the same objects, with the same ages; the matcher reuses their results.
ANSWER_REUSE_SECONDS = 0.1


class ContactTimes(Protocol):
    """The times of the last message from each other host, and of the loss of its link; monotonic clock."""

    @property
    def down_since(self) -> Mapping[str, float]:
        """The time since which each host without a link has had none."""

    def last_contact(self, host: str) -> float | None:
        """The time of the last message from a host; None without any."""


class _Remote(Struct):
    """The state received from another host in its `incarnation`.

    `is_in_sync` when no delta of it is missing here; else its values were current up to
    `fresh_until`.
    """

    incarnation: int = 0
    sequence: int = 0
    is_in_sync: bool = False
    fresh_until: float = 0.0
    conditions: dict[str, AgentCondition] = field(default_factory=dict)


class _HostState(Struct, frozen=True, gc=False):
    """The state of a host at the moment of a query: the conditions of its agents, and the start of its
    absence.

    The values of another host were certainly up to date until `fresh_until`; those of this host have their
    own ages.
    """

    conditions: Mapping[str, AgentCondition]
    down_since: float | None = None
    fresh_until: float = -math.inf
    hops: int = 0


class _CachedCandidate(Struct, frozen=True, gc=False):
    """A cached candidate, valid `until` then while condition and link are the same."""

    candidate: Candidate
    condition: AgentCondition
    down_since: float | None
    own: bool
    denials: Mapping[str, str]
    until: float


#: The value for agents whose portals the querying coordinator may all call.
NOTHING: Mapping[str, str] = {}


class AgentDirectory:
    """The agents of a mission in the directory of one `host`; `incarnation` identifies its run, not the
    next.

    Implements `offer.Team`. Only agents whose type is a provider of the registry are in it. `pose` is the
    place of the host in the devices file. A reserved agent can be called only by its holder:
    `asker` is the querying coordinator, '' for none.
    """

    def __init__(
        self,
        registry: Registry,
        agents: Sequence[AgentIdentity],
        host: str,
        links: ContactTimes,
        clock: Clock,
        incarnation: int = 1,
        pose: Position | None = None,
    ) -> None:
        self._pose = pose
        self._registry, self._own_host, self._links, self._clock = registry, host, links, clock
        self._agents: dict[str, AgentIdentity] = {a.id: a for a in agents if a.type in registry.providers}
        #: The agents of this host, whose conditions are set by `set_own`.
        self.own_agents = [agent.id for agent in self._agents.values() if agent.host == host]
        self._by_type: dict[str, list[AgentIdentity]] = {}
        for agent in self._agents.values():
            self._by_type.setdefault(agent.type, []).append(agent)
        self._profiles = agent_profiles(registry, agents)
        self._live = {agent.id: live_attributes(registry, agent) for agent in self._agents.values()}
        self.asker = ""
        #: By primitive the reasons why an asker may not call an agent, by agent id; None if all may call all.
        self.denials: Callable[[str, str], Mapping[str, str]] | None = None
        self._own_status: dict[str, AgentCondition] = {}
        self._replacements: dict[str, Callable[[AgentCondition], AgentCondition]] = {}
        self._cache: dict[str, _CachedCandidate] = {}
        self._announcer = DeltaEncoder(registry.attributes, incarnation)
        self._remotes = {agent.host: _Remote() for agent in self._agents.values() if agent.host != host}

    # --- this host's agents ---------------------------------------------------------------------------

    def answer_for(self, asker: str) -> None:
        """Set the coordinator of the next answers; '' for a person."""
        self.asker = asker

    def restrict(self, denials: Callable[[str, str], Mapping[str, str]]) -> None:
        """Set the access rules: `denials` has by primitive the reasons why a coordinator may not call an
        agent.
        """
        self.denials = denials

    def live(self, agent: str) -> Mapping[str, LiveAttribute]:
        """The live attributes of an agent, with the sources of their values."""
        return self._live[agent]

    def set_own(self, agent: str, condition: AgentCondition) -> None:
        """Set the condition of an agent of this host."""
        replacement = self._replacements.get(agent)
        self._own_status[agent] = condition if replacement is None else replacement(condition)

    def replace_own(self, agent: str, replacement: Callable[[AgentCondition], AgentCondition]) -> None:
        """Replace the condition of an agent of this host from now on: a test provides its attributes."""
        self._replacements[agent] = replacement

    def next_delta(self) -> DirectoryDelta | None:
        """The next delta for every other host; None when nothing has changed."""
        return self._announcer.next_delta(self._own_status)

    def full_delta(self) -> DirectoryDelta | None:
        """The full state for a host that was disconnected; None when nothing was ever sent."""
        return self._announcer.full_delta()

    # --- the other hosts ------------------------------------------------------------------------------

    def on_link_up(self, host: str, incarnation: int) -> None:
        """Record a link to a host; its values are current again after its full state has arrived."""
        remote = self._remotes.get(host)
        if remote is None:
            return
        self._is_out_of_sync(remote)
        if remote.incarnation != incarnation:
            self._remotes[host] = _Remote(incarnation)

    def on_link_down(self, host: str) -> None:
        """Record the loss of the link to a host."""
        remote = self._remotes.get(host)
        if remote is not None:
            self._is_out_of_sync(remote, self._links.last_contact(host))

    def on_delta(self, host: str, delta: DirectoryDelta) -> None:
        """Apply a delta of a host. Late, duplicate and non-consecutive deltas are ignored."""
        remote = self._remotes.get(host)
        if remote is None or delta.incarnation != remote.incarnation or delta.sequence <= remote.sequence:
            return
        if delta.since > remote.sequence or (delta.since and not remote.is_in_sync):
            self._is_out_of_sync(remote)
            return
        for agent, change in delta.agents.items():
            remote.conditions[agent] = remote.conditions.get(agent, UNCHANGED).updated(change)
        remote.sequence, remote.is_in_sync, remote.fresh_until = delta.sequence, True, self._clock.monotonic()

    def _is_out_of_sync(self, remote: _Remote, delta: float | None = None) -> None:
        if remote.is_in_sync:
            remote.is_in_sync, remote.fresh_until = False, max(remote.fresh_until, delta or 0.0)

    # --- Team -----------------------------------------------------------------------------------------

    def candidates(self, resource: str) -> list[Candidate]:
        """The agents of a resource type in their present state, in the order of the deployment."""
        return self._candidates(self._by_type.get(resource, ()))

    def location(self) -> Position | None:
        """The position of this host: that of the first of its agents with a known position, else its pose."""
        now, state = self._clock.monotonic(), self._host_state(self._own_host)
        own = (self._candidate(self._agents[agent], state, now) for agent in self.own_agents)
        return location_of(own, self._registry.attributes, self._pose)

    def all_candidates(self) -> list[Candidate]:
        """All agents in their present state, in the order of the deployment."""
        return self._candidates(self._agents.values())

    def _candidates(self, agents: Iterable[AgentIdentity]) -> list[Candidate]:
        # Written out, here and below, because a thousand agents go through it in a query.
        now, hosts, found = self._clock.monotonic(), dict[str, _HostState](), []
        for agent in agents:
            state = hosts.get(agent.host)
            if state is None:
                state = hosts[agent.host] = self._host_state(agent.host)
            found.append(self._candidate(agent, state, now))
        return found

    def _host_state(self, host: str) -> _HostState:
        if host == self._own_host:
            return _HostState(self._own_status)
        remote = self._remotes[host]
        contact = self._links.last_contact(host) if remote.is_in_sync else None
        kept_until = remote.fresh_until if contact is None else max(remote.fresh_until, contact)
        return _HostState(remote.conditions, self._links.down_since.get(host), kept_until, 1)

    def _candidate(self, agent: AgentIdentity, state: _HostState, now: float) -> Candidate:
        condition, down_since = state.conditions.get(agent.id, UNCHANGED), state.down_since
        own = condition.reserved is not None and condition.reserved.holder == self.asker
        denials = NOTHING if self.denials is None else self.denials(self.asker, agent.id)
        cached = self._cache.get(agent.id)
        if (
            cached is None
            or cached.condition is not condition
            or (cached.down_since, cached.own, cached.denials) != (down_since, own, denials)
            or now >= cached.until
        ):
            cached = self._cache[agent.id] = self._make_candidate(
                agent, condition, state, now, denials, own=own
            )
        return cached.candidate

    def _make_candidate(
        self,
        agent: AgentIdentity,
        condition: AgentCondition,
        state: _HostState,
        now: float,
        denials: Mapping[str, str],
        *,
        own: bool,
    ) -> _CachedCandidate:
        profile, reported, down_since = self._profiles[agent.id], {}, state.down_since
        unavailability = (
            condition.unavailability if down_since is None else Unavailability("unreachable", down_since)
        )
        if condition.samples:
            reported = _with_ages(condition.samples, state.fresh_until, now)
        reason = unavailability or (None if own else condition.reserved)
        refusal = reason.sentence(now) if reason else ""
        candidate = profile.candidate(
            state.hops, refusal, reported, condition.unknown, "{1} has not reported {0} yet"
        )
        if denials:
            candidate = replace(candidate, denials=denials)
        passing = reason or (reported and profile.measured)
        return _CachedCandidate(
            candidate,
            condition,
            down_since,
            own,
            denials,
            now + ANSWER_REUSE_SECONDS if passing else math.inf,
        )


def _with_ages(samples: Mapping[str, AttributeSample], kept_until: float, now: float) -> dict[str, Fact]:
    """The received values with their current ages; `is_kept_current` ones were renewed up to `kept_until`."""
    facts = {}
    for name, sample in samples.items():
        age = 0.0
        if sample.of == "measured":
            age = now - sample.when
            if sample.is_kept_current and kept_until > sample.at:
                age -= kept_until - sample.at
        facts[name] = Fact(sample.value, age if age > 0.0 else 0.0, sample.of)
    return facts

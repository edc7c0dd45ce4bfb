"""What one host knows of all agents of its mission: what each is worth now, and whether it can be called.

The agents and their own values come from the deployment and the registry. How its own agents are, the host
tells its directory (`own`); how the others are, their hosts tell in news (`take`). Nothing else happens here:
a question is answered from what is known.

A live value of another host is as old as that host said, and older by the time since something was last
heard from it: while the link lives and nothing is told, nothing has changed. A value that its host has
stopped renewing, and all values of a host that was away until it has told everything again, just grow older.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from msgspec import Struct
from msgspec.structs import replace

from lfield.capability.directory.news import SILENCE, Announcer, Condition, News, Sample, Trouble
from lfield.capability.directory.showing import Deployed, known_agents, live_attributes, place_of
from lfield.capability.model import Live, Registry
from lfield.capability.offer import Candidate, Fact, Place
from lfield.clock import Clock

#: Answers within so many seconds are the same objects, with the same ages: the matcher goes by that.
MOMENT = 0.1


class Links(Protocol):
    """What is known of the links to the other hosts, by host; times are on the monotonic clock."""

    @property
    def away(self) -> Mapping[str, float]:
        """Since when each host without a link has had none."""

    def last_heard(self, host: str) -> float | None:
        """When something last came from a host; None when nothing ever did."""


@dataclass(slots=True)
class _Remote:
    """What another host has told in its life `life`.

    `in_step` when nothing that it told since is missing here; else its values were kept up to `kept_until`.
    """

    life: int = 0
    sequence: int = 0
    in_step: bool = False
    kept_until: float = 0.0
    conditions: dict[str, Condition] = field(default_factory=dict)


class _Seen(Struct, frozen=True, gc=False):
    """How a host is at the moment of a question: how its agents are, and since when it is away.

    It surely kept its values up to date up to `kept_until`; those of this host are as old as they say.
    """

    conditions: Mapping[str, Condition]
    away: float | None = None
    kept_until: float = -math.inf
    hops: int = 0


class _Shown(Struct, frozen=True, gc=False):
    """A candidate as it was answered, good `until` then while condition and link are the same."""

    candidate: Candidate
    condition: Condition
    away: float | None
    own: bool
    barred: Mapping[str, str]
    until: float


#: Of agents that whoever asks may call by all their portals.
NOTHING: Mapping[str, str] = {}


class Directory:
    """The agents of a mission as the host `here` knows them; `life` tells this run of it from the next.

    Implements `offer.Team`. Only agents whose type is a provider of the registry are in it. `pose` is where
    the host stands by the devices file. What somebody has reserved can be called by nobody but its holder:
    `asker` is the coordinator that asks, '' for nobody.
    """

    def __init__(
        self,
        registry: Registry,
        agents: Sequence[Deployed],
        here: str,
        links: Links,
        clock: Clock,
        life: int = 1,
        pose: Place | None = None,
    ) -> None:
        self._pose = pose
        self._registry, self._here, self._links, self._clock = registry, here, links, clock
        self._agents: dict[str, Deployed] = {a.id: a for a in agents if a.type in registry.providers}
        #: The agents of this host, whose conditions `own` wants.
        self.own_agents = [agent.id for agent in self._agents.values() if agent.host == here]
        self._by_type: dict[str, list[Deployed]] = {}
        for agent in self._agents.values():
            self._by_type.setdefault(agent.type, []).append(agent)
        self._known = known_agents(registry, agents)
        self._live = {agent.id: live_attributes(registry, agent) for agent in self._agents.values()}
        self.asker = ""
        #: By primitive why an asker may not call an agent for it, by their ids; None where all may call all.
        self.barred: Callable[[str, str], Mapping[str, str]] | None = None
        self._own: dict[str, Condition] = {}
        self._shown: dict[str, _Shown] = {}
        self._announcer = Announcer(registry.attributes, life)
        self._remotes = {agent.host: _Remote() for agent in self._agents.values() if agent.host != here}

    # --- this host's agents ---------------------------------------------------------------------------

    def live(self, agent: str) -> Mapping[str, Live]:
        """The live attributes of an agent, with where their values come from."""
        return self._live[agent]

    def own(self, agent: str, condition: Condition) -> None:
        """How an agent of this host is now."""
        self._own[agent] = condition

    def news(self) -> News | None:
        """What every other host has to be told now, None when nothing has changed."""
        return self._announcer.changes(self._own)

    def everything(self) -> News | None:
        """What a host has to be told that was away; None when nothing was ever told."""
        return self._announcer.everything()

    # --- the other hosts ------------------------------------------------------------------------------

    def linked(self, host: str, life: int) -> None:
        """A link to a host is there; its values count as kept again when it has told everything."""
        remote = self._remotes.get(host)
        if remote is None:
            return
        self._out_of_step(remote)
        if remote.life != life:
            self._remotes[host] = _Remote(life)

    def unlinked(self, host: str) -> None:
        """The link to a host is gone."""
        remote = self._remotes.get(host)
        if remote is not None:
            self._out_of_step(remote, self._links.last_heard(host))

    def take(self, host: str, news: News) -> None:
        """Take in what a host tells. What is late, comes twice or does not connect is left out."""
        remote = self._remotes.get(host)
        if remote is None or news.life != remote.life or news.sequence <= remote.sequence:
            return
        if news.since > remote.sequence or (news.since and not remote.in_step):
            self._out_of_step(remote)
            return
        for agent, change in news.agents.items():
            remote.conditions[agent] = remote.conditions.get(agent, SILENCE).updated(change)
        remote.sequence, remote.in_step, remote.kept_until = news.sequence, True, self._clock.monotonic()

    def _out_of_step(self, remote: _Remote, heard: float | None = None) -> None:
        if remote.in_step:
            remote.in_step, remote.kept_until = False, max(remote.kept_until, heard or 0.0)

    # --- Team -----------------------------------------------------------------------------------------

    def candidates(self, resource: str) -> list[Candidate]:
        """The agents of a resource type as they are now, in the order of the deployment."""
        return self._candidates(self._by_type.get(resource, ()))

    def here(self) -> Place | None:
        """Where this host is: where the first of its agents is whose place is known, else its pose."""
        now, seen = self._clock.monotonic(), self._seen(self._here)
        own = (self._candidate(self._agents[agent], seen, now) for agent in self.own_agents)
        return place_of(own, self._registry.attributes, self._pose)

    def everybody(self) -> list[Candidate]:
        """All agents as they are now, in the order of the deployment."""
        return self._candidates(self._agents.values())

    def _candidates(self, agents: Iterable[Deployed]) -> list[Candidate]:
        # Written out, here and below, because a thousand agents go through it in a query.
        now, hosts, found = self._clock.monotonic(), dict[str, _Seen](), []
        for agent in agents:
            seen = hosts.get(agent.host)
            if seen is None:
                seen = hosts[agent.host] = self._seen(agent.host)
            found.append(self._candidate(agent, seen, now))
        return found

    def _seen(self, host: str) -> _Seen:
        if host == self._here:
            return _Seen(self._own)
        remote = self._remotes[host]
        heard = self._links.last_heard(host) if remote.in_step else None
        kept_until = remote.kept_until if heard is None else max(remote.kept_until, heard)
        return _Seen(remote.conditions, self._links.away.get(host), kept_until, 1)

    def _candidate(self, agent: Deployed, seen: _Seen, now: float) -> Candidate:
        condition, away = seen.conditions.get(agent.id, SILENCE), seen.away
        own = condition.reserved is not None and condition.reserved.holder == self.asker
        barred = NOTHING if self.barred is None else self.barred(self.asker, agent.id)
        shown = self._shown.get(agent.id)
        if (
            shown is None
            or shown.condition is not condition
            or (shown.away, shown.own, shown.barred) != (away, own, barred)
            or now >= shown.until
        ):
            shown = self._shown[agent.id] = self._show(agent, condition, seen, now, barred, own=own)
        return shown.candidate

    def _show(
        self,
        agent: Deployed,
        condition: Condition,
        seen: _Seen,
        now: float,
        barred: Mapping[str, str],
        *,
        own: bool,
    ) -> _Shown:
        known, told, away = self._known[agent.id], {}, seen.away
        trouble = condition.trouble if away is None else Trouble("unreachable", away)
        if condition.samples:
            told = _with_ages(condition.samples, seen.kept_until, now)
        why = trouble or (None if own else condition.reserved)
        refusal = why.sentence(now) if why else ""
        candidate = known.shown(seen.hops, refusal, told, condition.unknown, "{1} has not told {0} yet")
        if barred:
            candidate = replace(candidate, barred=barred)
        passing = why or (told and known.measured)
        return _Shown(candidate, condition, away, own, barred, now + MOMENT if passing else math.inf)


def _with_ages(samples: Mapping[str, Sample], kept_until: float, now: float) -> dict[str, Fact]:
    """What was told, as old as it is now: what is kept has moved on with its host, up to `kept_until`."""
    facts = {}
    for name, sample in samples.items():
        age = 0.0
        if sample.of == "measured":
            age = now - sample.when
            if sample.kept and kept_until > sample.at:
                age -= kept_until - sample.at
        facts[name] = Fact(sample.value, age if age > 0.0 else 0.0, sample.of)
    return facts

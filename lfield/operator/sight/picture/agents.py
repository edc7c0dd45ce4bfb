"""Where the agents of a team are, and what they do, as the events of all hosts tell. Pure.

Hosts tell of one coordinator each for itself, and what they say arrives in any order. What counts is the
newest hop: (generation, sequence) grows with each, whatever the clocks say.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field

from lfield.operator.sight.picture.roll import Enrolled, Roll
from lfield.operator.sight.seen import AgentSeen, HopSeen
from lfield.wire import events
from lfield.wire.coordinators import Known
from lfield.wire.observing import AgentStatus

#: A host may name whomever it likes: of so many agents is told.
MOST_AGENTS = 4096
#: So many hops of each coordinator are shown.
TRAIL = 12
#: What happened longer ago (s) is no matter of hops a minute.
MINUTE = 60.0

#: What was told of an agent so much earlier (s) than what another host tells is over.
STALE = 1.5

#: The parts of a hop, and all that tells of an agent.
HopEvent = events.Left | events.Came | events.Hopped | events.Stayed
AgentEvent = (
    HopEvent
    | events.Started
    | events.Finished
    | events.Doubted
    | events.Recovered
    | events.Superseded
    | events.Standing
)


#: State, file, line, and what it waits for.
Stood = tuple[str, str, int, str]
_NOWHERE: Stood = ("", "", 0, "")


@dataclass(slots=True)
class _Hop:
    generation: int
    sequence: int
    of: str
    to: str
    when: float
    resource: str = ""
    portal: str = ""
    size: int = 0
    seconds: float | None = None
    failed: str = ""
    came: bool = False


@dataclass(slots=True)
class _Agent:
    """What is known of one; times are of our monotonic clock."""

    enrolled: Enrolled
    host: str
    generation: int = 0
    sequence: int = 0
    when: float | None = None
    hops: int = 0
    #: Whether all hops of this start are counted, as of one that was heard to begin, or of its own host.
    counted: bool = False
    served: int = 0
    to: str = ""
    state: str = ""
    file: str = ""
    line: int = 0
    waits: str = ""
    finished: str = ""
    detail: str = ""
    doubt: str = ""
    trail: list[_Hop] = field(default_factory=list)
    came: deque[float] = field(default_factory=deque)
    #: What each host told last of where it stands there: that is not told again as long as it is the same.
    stood: dict[str, Stood] = field(default_factory=dict)
    #: The newest hop of the newest start that each host has told of in its life.
    newest: dict[str, tuple[int, int]] = field(default_factory=dict)

    def outdates(self, generation: int, sequence: int) -> bool:
        """Whether more is known than that hop of that start. One that gave way to another knows nothing."""
        if self.finished == "superseded":
            return False
        return (generation, sequence) < (self.generation, self.sequence)

    def hears(self, host: str, generation: int, sequence: int, linked: Collection[str]) -> None:
        """A host tells of that hop of that start. Starts are counted anew in a new run of the mission: what a
        life of a host tells first is that, where nobody who is heard has told of more."""
        hop = (generation, sequence)
        is_first = host not in self.newest
        self.newest[host] = max(hop, self.newest.get(host, hop))
        others = (known for name, known in self.newest.items() if name in linked)
        if is_first and self.outdates(*hop) and hop >= max(others, default=hop):
            self.newest = {host: hop}
            self.generation = self.sequence = self.hops = 0
            self.counted = False
            self.trail.clear()
            self.came.clear()
            self.to = self.finished = self.detail = self.doubt = ""

    def runs(self, host: str, generation: int, sequence: int, when: float) -> None:
        """It runs on a host."""
        self.host, self.generation, self.sequence, self.when = host, generation, sequence, when
        self.to = self.finished = self.detail = self.doubt = ""

    def stands(self, state: str, file: str = "", line: int = 0, waits: str = "") -> None:
        """What it does."""
        self.state, self.file, self.line, self.waits = state, file, line, waits

    def arrives(self, host: str, generation: int, sequence: int, when: float) -> None:
        """It runs on a host where it did not before."""
        self.runs(host, generation, sequence, when)
        self.stands(*self.stood.get(host, _NOWHERE))

    def hop(self, generation: int, sequence: int) -> _Hop | None:
        """A hop of its trail."""
        return next((h for h in self.trail if (h.generation, h.sequence) == (generation, sequence)), None)

    def add(self, hop: _Hop) -> None:
        """A hop that was not heard of before, in its place among those that are shown."""
        self.trail.append(hop)
        self.trail.sort(key=lambda each: (each.generation, each.sequence))
        del self.trail[:-TRAIL]


class Agents:
    """All agents of a team."""

    def __init__(self, roll: Roll) -> None:
        self._roll = roll
        self._linked: set[str] = set()
        self._known = {name: _Agent(enrolled, enrolled.host) for name, enrolled in roll.agents.items()}
        self._kinds: dict[str, str] = {name: enrolled.kind for name, enrolled in roll.agents.items()}

    def told(self, host: str, event: AgentEvent, when: float, *, is_past: bool = False) -> None:
        """An event of a host that happened at `when`.

        Of one that `is_past`, since a snapshot has told what came of it, only the hop itself is new.
        """
        agent = self._agent(event.agent, host)
        self._linked.add(host)
        if isinstance(event, HopEvent):
            agent.hears(host, event.generation, event.sequence, self._linked)
        elif isinstance(event, events.Started) and not is_past:
            agent.hears(host, event.generation, 0, self._linked)
        if is_past and not isinstance(event, HopEvent):
            return
        match event:
            case events.Left() | events.Came() | events.Hopped() | events.Stayed():
                self._is_of(event.agent, "coordinator")
                _hopped(agent, host, event, when, is_past=is_past)
            case events.Standing(_, state, file, line, waits):
                agent.stood[host] = (state, file, line, waits)
                if agent.host != host and _is_stale(agent, when) and self._moves(event.agent):
                    # It hopped so often that its hosts could not tell each hop.
                    agent.host, agent.to = host, ""
                if agent.host == host and not agent.finished:
                    agent.stands(state, file, line, waits)
                    agent.when = when
            case events.Doubted(_, generation, _, reason):
                if generation >= agent.generation:
                    agent.doubt = reason or "nobody knows whether it lives"
            case events.Started(_, generation) | events.Recovered(_, generation):
                if not agent.outdates(generation, agent.sequence):
                    sequence = agent.sequence if generation == agent.generation else 0
                    agent.runs(host, generation, sequence, when)
                agent.counted = agent.counted or isinstance(event, events.Started)
            case events.Finished(_, generation, how, detail):
                self._finished(agent, host, generation, how, detail, when)
            case events.Superseded(_, generation, reason):
                self._finished(agent, host, generation, "superseded", reason, when)

    def _is_of(self, name: str, kind: str) -> None:
        if name in self._known:
            self._kinds[name] = kind

    def _moves(self, name: str) -> bool:
        return self._kinds.get(name) == "coordinator"

    def served(self, host: str, resource: str) -> None:
        """A portal of a resource has ended."""
        self._agent(resource, host).served += 1

    def _finished(
        self, agent: _Agent, host: str, generation: int, how: str, detail: str, when: float
    ) -> None:
        if generation < agent.generation or (how == "superseded" and agent.finished):
            return
        agent.generation, agent.finished, agent.detail, agent.when = generation, how, detail, when
        agent.host, agent.to, agent.doubt = host, "", ""
        agent.stands("")

    def status(self, host: str, agents: Iterable[AgentStatus], known: Iterable[Known], now: float) -> None:
        """What a host knows of all agents. Of coordinators only it says which start and hop it means."""
        here = {told.id for told in agents}
        self._linked.add(host)
        for copy in known:
            self._is_of(copy.agent, "coordinator")
            agent = self._agent(copy.agent, copy.where or host)
            agent.hears(host, copy.generation, copy.sequence, self._linked)
            _copy(agent, host, copy, now)
        for told in agents:
            agent = self._agent(told.id, host)
            self._is_of(told.id, told.kind)
            if told.kind == "resource":
                agent.host, agent.when = host, now
            if agent.host == host:
                agent.hops, agent.served = max(agent.hops, told.hops), told.served
                agent.stands(told.state, agent.file, agent.line, agent.waits)
        for agent in self._known.values():
            if agent.host == host and agent.enrolled.agent not in here and not (agent.to or agent.finished):
                agent.stands("not heard of here" if agent.when is not None else "")

    def linked(self, host: str) -> None:
        """A host is followed anew: it tells everything again."""
        for agent in self._known.values():
            agent.stood.pop(host, None)

    def unlinked(self, host: str) -> None:
        """A host is not heard any more."""
        self._linked.discard(host)

    def restarted(self, host: str) -> None:
        """Another life of a host: what its resources did, and stood at, is over."""
        for agent in self._known.values():
            agent.newest.pop(host, None)
            if agent.host == host and not agent.to:
                agent.stands("")
                if self._kinds.get(agent.enrolled.agent) == "resource":
                    agent.finished = agent.detail = ""
                    agent.served = 0

    def _agent(self, name: str, host: str) -> _Agent:
        agent = self._known.get(name)
        if agent is None:
            agent = _Agent(Enrolled(name, "", host), host)
            if len(self._known) < MOST_AGENTS:
                self._known[name] = agent
        return agent

    # --- out ------------------------------------------------------------------------------------------

    def enrolled(self, name: str) -> Enrolled:
        """Who that is by the files, or by what was heard."""
        agent = self._known.get(name)
        return agent.enrolled if agent is not None else Enrolled(name, "", "")

    def hops_a_minute(self, now: float) -> Mapping[str, float]:
        """How often each coordinator came anywhere within the last minute."""
        found = {}
        for name, agent in self._known.items():
            while agent.came and agent.came[0] < now - MINUTE:
                agent.came.popleft()
            if self._moves(name):
                found[name] = float(len(agent.came))
        return found

    def seen(self, now: float, fresh: Mapping[str, bool]) -> dict[str, AgentSeen]:
        """All agents, in the order of the deployment; `fresh` says of each host whether it is heard."""
        return {name: self._seen(name, agent, now, fresh) for name, agent in self._known.items()}

    def _seen(self, name: str, agent: _Agent, now: float, fresh: Mapping[str, bool]) -> AgentSeen:
        return AgentSeen(
            agent=name,
            type=agent.enrolled.type,
            kind="coordinator" if self._moves(name) else "resource",
            host=agent.host,
            fresh=fresh.get(agent.host, False),
            age=None if agent.when is None else max(0.0, now - agent.when),
            generation=agent.generation,
            hops=agent.hops if agent.counted or agent.hops or not agent.finished else None,
            served=agent.served,
            to=agent.to,
            state=agent.state,
            file=agent.file,
            line=agent.line,
            waits=agent.waits,
            finished=agent.finished,
            detail=agent.detail,
            doubt=agent.doubt,
            trail=tuple(_shown(hop, now) for hop in agent.trail),
        )


def _is_stale(agent: _Agent, when: float) -> bool:
    """Whether its host has not told of it for so long that another one is believed that does."""
    return not agent.finished and (agent.when is None or when > agent.when + STALE)


def _shown(hop: _Hop, now: float) -> HopSeen:
    age = max(0.0, now - hop.when)
    return HopSeen(
        hop.sequence, hop.of, hop.to, age, hop.resource, hop.portal, hop.size, hop.seconds, hop.failed
    )


def _hopped(agent: _Agent, host: str, event: HopEvent, when: float, *, is_past: bool) -> None:
    """A part of a hop, in any order: what was heard of the hop before counts, and what comes is added."""
    generation, sequence = event.generation, event.sequence
    hop, is_old = agent.hop(generation, sequence), is_past or agent.outdates(generation, sequence)
    match event:
        case events.Left(_, _, _, to, resource, portal, size):
            if hop is None:
                hop = _Hop(generation, sequence, host, to, when)
                agent.add(hop)
                if not is_old:
                    agent.runs(host, generation, sequence, when)
                    agent.to = to
                    agent.stands("on its way")
            hop.resource, hop.portal, hop.size, hop.when = resource, portal, size, min(hop.when, when)
        case events.Came(_, _, _, of, size):
            if hop is None:
                hop = _Hop(generation, sequence, of, host, when, size=size)
                agent.add(hop)
            if not is_old and not hop.came:
                hop.came = True
                agent.hops += 1
                agent.came.append(when)
                agent.arrives(host, generation, sequence, when)
        case events.Hopped(_, _, _, to, seconds):
            if hop is not None:
                hop.seconds = seconds
            if not is_old and agent.to == to:
                agent.arrives(to, generation, sequence, when)
        case events.Stayed(_, _, _, _, exception, reason):
            if hop is not None:
                hop.failed = ": ".join(filter(None, (exception, reason))) or "it stayed"
            if not is_old:
                agent.arrives(host, generation, sequence, when)


def _copy(agent: _Agent, host: str, known: Known, now: float) -> None:
    """What a host knows of one start, whether it is there or not."""
    generation, sequence = known.generation, known.sequence
    if agent.outdates(generation, sequence):
        return
    is_newer = (generation, sequence) > (agent.generation, agent.sequence) or agent.when is None
    match known.state:
        case "RUN":
            agent.hops, agent.counted = known.hops, True
            if is_newer or agent.host != host or agent.to:
                agent.runs(host, generation, sequence, now)
        case "FROZEN" | "PREPARED":
            agent.runs(host, generation, sequence, now)
            agent.to = known.where
            agent.stands("on its way")
        case "IN DOUBT":
            agent.doubt = known.detail or "nobody knows whether it lives"
        case "MOVED":
            if is_newer:
                agent.runs(known.where, generation, sequence, now)
        case "EXITED":
            if known.where in ("", host):
                # Who has only heard of the end does not know how often it went on.
                agent.hops, agent.counted = max(agent.hops, known.hops), True
            agent.finished, agent.detail = known.outcome or "done", known.detail
            agent.generation, agent.host, agent.to, agent.doubt = generation, known.where or host, "", ""
            agent.stands("")
        case "PARKED":
            agent.stands("parked")

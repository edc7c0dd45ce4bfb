"""Tracks the location and activity of a team's agents, from the events of all hosts. Sans-IO.

Several hosts report on one coordinator, and their events arrive in any order. The newest hop counts:
(generation, sequence) grows with each hop, independent of clocks.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Mapping

from msgspec import Struct, field

from lfield.operator.team_model.team_contents import TeamContents, TeamEntry
from lfield.operator.team_model.team_state import AgentState, HopState
from lfield.wire import events
from lfield.wire.coordinator_messages import CoordinatorState
from lfield.wire.observer_messages import AgentStatus

#: The most agents tracked: hosts may report any names.
MAX_AGENTS = 4096
#: The number of recent hops shown of each coordinator.
TRAIL_LENGTH = 12
#: Window of the hop rate, in seconds.
MINUTE = 60.0

#: A report that is older than another host's report by this many seconds is outdated.
STALE = 1.5

#: The events of a hop, and all events about agents.
HopEvent = (
    events.MigrationStarted | events.MigrationArrived | events.MigrationConfirmed | events.MigrationFailed
)
AgentEvent = (
    HopEvent
    | events.AgentStarted
    | events.AgentFinished
    | events.MigrationInDoubt
    | events.CoordinatorRecovered
    | events.CoordinatorSuperseded
    | events.AgentActivity
)


#: State, file, line, and the portal or instruction that the agent waits for.
ProgramPosition = tuple[str, str, int, str]
_NO_POSITION: ProgramPosition = ("", "", 0, "")


class _Hop(Struct):
    generation: int
    sequence: int
    source: str
    target: str
    when: float
    resource: str = ""
    portal: str = ""
    size: int = 0
    seconds: float | None = None
    failed: str = ""
    has_arrived: bool = False


class _Agent(Struct):
    """One agent; times are on the monotonic clock of this computer."""

    entry: TeamEntry
    host: str
    generation: int = 0
    sequence: int = 0
    when: float | None = None
    hops: int = 0
    #: Whether all hops of this start are counted: the start was received, or its own host reports it.
    counted: bool = False
    served: int = 0
    target: str = ""
    state: str = ""
    file: str = ""
    line: int = 0
    waits: str = ""
    finished: str = ""
    detail: str = ""
    doubt: str = ""
    trail: list[_Hop] = field(default_factory=list)
    arrivals: deque[float] = field(default_factory=deque)
    #: The last reported position on each host, which is not reported again while it is unchanged.
    positions: dict[str, ProgramPosition] = field(default_factory=dict)
    #: The newest hop of the newest start that each host has reported in its incarnation.
    newest: dict[str, tuple[int, int]] = field(default_factory=dict)

    def knows_newer_than(self, generation: int, sequence: int) -> bool:
        """Whether a later hop of that start than this one is known; for a superseded start, always False."""
        if self.finished == "superseded":
            return False
        return (generation, sequence) < (self.generation, self.sequence)

    def on_report(self, host: str, generation: int, sequence: int, linked: Collection[str]) -> None:
        """Handle a report of a host about that hop of that start. Starts are counted again in a new run of
        the mission: the first report of an incarnation starts one, unless a linked host has reported a
        later one.
        """
        hop = (generation, sequence)
        is_first = host not in self.newest
        self.newest[host] = max(hop, self.newest.get(host, hop))
        others = (known for name, known in self.newest.items() if name in linked)
        if is_first and self.knows_newer_than(*hop) and hop >= max(others, default=hop):
            self.newest = {host: hop}
            self.generation = self.sequence = self.hops = 0
            self.counted = False
            self.trail.clear()
            self.arrivals.clear()
            self.target = self.finished = self.detail = self.doubt = ""

    def set_running(self, host: str, generation: int, sequence: int, when: float) -> None:
        """Set that the agent runs on a host."""
        self.host, self.generation, self.sequence, self.when = host, generation, sequence, when
        self.target = self.finished = self.detail = self.doubt = ""

    def set_position(self, state: str, file: str = "", line: int = 0, waits: str = "") -> None:
        """Set the activity of the agent."""
        self.state, self.file, self.line, self.waits = state, file, line, waits

    def on_arrival(self, host: str, generation: int, sequence: int, when: float) -> None:
        """Set that the agent runs on a host where it did not run before."""
        self.set_running(host, generation, sequence, when)
        self.set_position(*self.positions.get(host, _NO_POSITION))

    def hop(self, generation: int, sequence: int) -> _Hop | None:
        """A hop in the agent's trail."""
        return next((h for h in self.trail if (h.generation, h.sequence) == (generation, sequence)), None)

    def add(self, hop: _Hop) -> None:
        """Insert a new hop at its place among those shown."""
        self.trail.append(hop)
        self.trail.sort(key=lambda each: (each.generation, each.sequence))
        del self.trail[:-TRAIL_LENGTH]


class AgentTracker:
    """All agents of a team."""

    def __init__(self, inventory: TeamContents) -> None:
        self._inventory = inventory
        self._linked: set[str] = set()
        self._known = {name: _Agent(enrolled, enrolled.host) for name, enrolled in inventory.agents.items()}
        self._kinds: dict[str, str] = {name: enrolled.kind for name, enrolled in inventory.agents.items()}

    def on_event(self, host: str, event: AgentEvent, when: float, *, is_past: bool = False) -> None:
        """Handle an event of a host that happened at `when`.

        If the event `is_past`, a snapshot contains its consequences, and only the hop itself is new.
        """
        agent = self._agent(event.agent, host)
        self._linked.add(host)
        if isinstance(event, HopEvent):
            agent.on_report(host, event.generation, event.sequence, self._linked)
        elif isinstance(event, events.AgentStarted) and not is_past:
            agent.on_report(host, event.generation, 0, self._linked)
        if is_past and not isinstance(event, HopEvent):
            return
        match event:
            case (
                events.MigrationStarted()
                | events.MigrationArrived()
                | events.MigrationConfirmed()
                | events.MigrationFailed()
            ):
                self._is_of(event.agent, "coordinator")
                _on_hop(agent, host, event, when, is_past=is_past)
            case events.AgentActivity(_, state, file, line, waits):
                agent.positions[host] = (state, file, line, waits)
                if agent.host != host and _is_stale(agent, when) and self._is_coordinator(event.agent):
                    # The agent hops so often that its hosts could not report each hop.
                    agent.host, agent.target = host, ""
                if agent.host == host and not agent.finished:
                    agent.set_position(state, file, line, waits)
                    agent.when = when
            case events.MigrationInDoubt(_, generation, _, reason):
                if generation >= agent.generation:
                    agent.doubt = reason or "unknown whether it is alive"
            case events.AgentStarted(_, generation) | events.CoordinatorRecovered(_, generation):
                if not agent.knows_newer_than(generation, agent.sequence):
                    sequence = agent.sequence if generation == agent.generation else 0
                    agent.set_running(host, generation, sequence, when)
                agent.counted = agent.counted or isinstance(event, events.AgentStarted)
            case events.AgentFinished(_, generation, how, detail):
                self._on_finished(agent, host, generation, how, detail, when)
            case events.CoordinatorSuperseded(_, generation, reason):
                self._on_finished(agent, host, generation, "superseded", reason, when)

    def _is_of(self, name: str, kind: str) -> None:
        if name in self._known:
            self._kinds[name] = kind

    def _is_coordinator(self, name: str) -> bool:
        return self._kinds.get(name) == "coordinator"

    def on_served(self, host: str, resource: str) -> None:
        """Handle the end of a portal call of a resource."""
        self._agent(resource, host).served += 1

    def _on_finished(
        self, agent: _Agent, host: str, generation: int, how: str, detail: str, when: float
    ) -> None:
        if generation < agent.generation or (how == "superseded" and agent.finished):
            return
        agent.generation, agent.finished, agent.detail, agent.when = generation, how, detail, when
        agent.host, agent.target, agent.doubt = host, "", ""
        agent.set_position("")

    def on_status(
        self, host: str, agents: Iterable[AgentStatus], known: Iterable[CoordinatorState], now: float
    ) -> None:
        """Handle the status of all agents from one host. Only its coordinator records have start and hop."""
        reported_ids = {reported.id for reported in agents}
        self._linked.add(host)
        for copy in known:
            self._is_of(copy.agent, "coordinator")
            agent = self._agent(copy.agent, copy.where or host)
            agent.on_report(host, copy.generation, copy.sequence, self._linked)
            _on_record(agent, host, copy, now)
        for reported in agents:
            agent = self._agent(reported.id, host)
            self._is_of(reported.id, reported.kind)
            if reported.kind == "resource":
                agent.host, agent.when = host, now
            if agent.host == host:
                agent.hops, agent.served = max(agent.hops, reported.hops), reported.served
                agent.set_position(reported.state, agent.file, agent.line, agent.waits)
        for agent in self._known.values():
            is_reported = agent.entry.agent in reported_ids
            if agent.host == host and not (is_reported or agent.target or agent.finished):
                agent.set_position("not reported" if agent.when is not None else "")

    def on_startable(self, host: str, names: Iterable[str], now: float) -> None:
        """Handle the coordinators of a host that others may start, and that do not run; after its status."""
        for name in names:
            self._is_of(name, "coordinator")
            agent = self._agent(name, host)
            if not agent.finished:
                agent.host, agent.when = host, now
                agent.set_position("startable")

    def on_linked(self, host: str) -> None:
        """Prepare for a host that is followed again, and reports all its data again."""
        for agent in self._known.values():
            agent.positions.pop(host, None)

    def on_unlinked(self, host: str) -> None:
        """Record that a host is unreachable."""
        self._linked.discard(host)

    def on_restarted(self, host: str) -> None:
        """Clear the activity of the resources of a host with a new incarnation."""
        for agent in self._known.values():
            agent.newest.pop(host, None)
            if agent.host == host and not agent.target:
                agent.set_position("")
                if self._kinds.get(agent.entry.agent) == "resource":
                    agent.finished = agent.detail = ""
                    agent.served = 0

    def _agent(self, name: str, host: str) -> _Agent:
        agent = self._known.get(name)
        if agent is None:
            agent = _Agent(TeamEntry(name, "", host), host)
            if len(self._known) < MAX_AGENTS:
                self._known[name] = agent
        return agent

    # --- queries --------------------------------------------------------------------------------------

    def entry(self, name: str) -> TeamEntry:
        """The agent's entry in the files, or one made from reports."""
        agent = self._known.get(name)
        return agent.entry if agent is not None else TeamEntry(name, "", "")

    def hops_a_minute(self, now: float) -> Mapping[str, float]:
        """Arrivals of each coordinator within the last minute."""
        found = {}
        for name, agent in self._known.items():
            while agent.arrivals and agent.arrivals[0] < now - MINUTE:
                agent.arrivals.popleft()
            if self._is_coordinator(name):
                found[name] = float(len(agent.arrivals))
        return found

    def snapshot(self, now: float, fresh: Mapping[str, bool]) -> dict[str, AgentState]:
        """All agents, in the order of the deployment; `fresh` is whether each host is linked."""
        return {name: self._agent_state(name, agent, now, fresh) for name, agent in self._known.items()}

    def _agent_state(self, name: str, agent: _Agent, now: float, fresh: Mapping[str, bool]) -> AgentState:
        return AgentState(
            agent=name,
            type=agent.entry.type,
            kind="coordinator" if self._is_coordinator(name) else "resource",
            host=agent.host,
            fresh=fresh.get(agent.host, False),
            age=None if agent.when is None else max(0.0, now - agent.when),
            generation=agent.generation,
            hops=agent.hops if agent.counted or agent.hops or not agent.finished else None,
            served=agent.served,
            target=agent.target,
            state=agent.state,
            file=agent.file,
            line=agent.line,
            waits_for=agent.waits,
            finished=agent.finished,
            detail=agent.detail,
            doubt=agent.doubt,
            trail=tuple(_hop_state(hop, now) for hop in agent.trail),
        )


def _is_stale(agent: _Agent, when: float) -> bool:
    """Whether the agent's host has not reported it for so long that another host's report takes
    precedence.
    """
    return not agent.finished and (agent.when is None or when > agent.when + STALE)


def _hop_state(hop: _Hop, now: float) -> HopState:
    age = max(0.0, now - hop.when)
    return HopState(
        hop.sequence, hop.source, hop.target, age, hop.resource, hop.portal, hop.size, hop.seconds, hop.failed
    )


def _on_hop(agent: _Agent, host: str, event: HopEvent, when: float, *, is_past: bool) -> None:
    """Handle one event of a hop, in any order: it is combined with the earlier ones."""
    generation, sequence = event.generation, event.sequence
    hop, is_old = agent.hop(generation, sequence), is_past or agent.knows_newer_than(generation, sequence)
    match event:
        case events.MigrationStarted(_, _, _, target, resource, portal, size):
            if hop is None:
                hop = _Hop(generation, sequence, host, target, when)
                agent.add(hop)
                if not is_old:
                    agent.set_running(host, generation, sequence, when)
                    agent.target = target
                    agent.set_position("on its way")
            hop.resource, hop.portal, hop.size, hop.when = resource, portal, size, min(hop.when, when)
        case events.MigrationArrived(_, _, _, source, size):
            if hop is None:
                hop = _Hop(generation, sequence, source, host, when, size=size)
                agent.add(hop)
            if not is_old and not hop.has_arrived:
                hop.has_arrived = True
                agent.hops += 1
                agent.arrivals.append(when)
                agent.on_arrival(host, generation, sequence, when)
        case events.MigrationConfirmed(_, _, _, target, seconds):
            if hop is not None:
                hop.seconds = seconds
            if not is_old and agent.target == target:
                agent.on_arrival(target, generation, sequence, when)
        case events.MigrationFailed(_, _, _, _, exception, reason):
            if hop is not None:
                hop.failed = ": ".join(filter(None, (exception, reason))) or "it stayed"
            if not is_old:
                agent.on_arrival(host, generation, sequence, when)


def _on_record(agent: _Agent, host: str, record: CoordinatorState, now: float) -> None:
    """Handle the record of a host about one start."""
    generation, sequence = record.generation, record.sequence
    if agent.knows_newer_than(generation, sequence):
        return
    is_newer = (generation, sequence) > (agent.generation, agent.sequence) or agent.when is None
    match record.state:
        case "RUN":
            agent.hops, agent.counted = record.hops, True
            if is_newer or agent.host != host or agent.target:
                agent.set_running(host, generation, sequence, now)
        case "FROZEN" | "PREPARED":
            agent.set_running(host, generation, sequence, now)
            agent.target = record.where
            agent.set_position("on its way")
        case "IN DOUBT":
            agent.doubt = record.detail or "unknown whether it is alive"
        case "MOVED":
            if is_newer:
                agent.set_running(record.where, generation, sequence, now)
        case "EXITED":
            if record.where in ("", host):
                # A record of an end does not contain the number of hops.
                agent.hops, agent.counted = max(agent.hops, record.hops), True
            agent.finished, agent.detail = record.outcome or "done", record.detail
            agent.generation, agent.host, agent.target, agent.doubt = generation, record.where or host, "", ""
            agent.set_position("")
        case "PARKED":
            agent.set_position("parked")

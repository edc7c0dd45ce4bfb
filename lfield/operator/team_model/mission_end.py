"""Whether a mission has ended, by observation: no coordinator is alive on a host that is waited for. Pure.

A subscriber gets the events of all hosts. From time to time it also queries them, since a host does not
record every hop. Both update the state of each start of a coordinator on each host (`CoordinatorState`). The
rules are those of `lfield up --until-done`:

- A start that is alive on a host decides: the mission continues. Otherwise the newest start counts, and an
  earlier one only if that is lost.
- An unreachable host is waited for as long as another host has a link with it, and `lost_after` seconds more.
  Then a coordinator that may be there has an unknown end.
- A coordinator that no host has, although all have answered twice in a row, is lost.
- The record of a journal about an earlier run counts when the home has had time to start the coordinator
again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

from msgspec import Struct, field
from msgspec.structs import replace

from lfield.clock import Clock
from lfield.errors import LfieldError
from lfield.wire import events
from lfield.wire.coordinator_messages import TERMINATED, CoordinatorState
from lfield.wire.observer_messages import Status
from lfield.wire.subscription_messages import EventBatch

#: Seconds between two queries: regularly, and while a coordinator is on no host.
QUERY_INTERVAL, SEARCH_INTERVAL = 10.0, 1.0
#: Queries in a row that must miss a coordinator before it is lost.
LOST_QUERIES = 2
#: Seconds in which a home with a journal starts its coordinators, if it starts them.
SETTLE_TIME = 5.0

_ALIVE = ("RUN", "FROZEN", "PREPARED")

Start = tuple[str, int]


class CoordinatorEnd(NamedTuple):
    """The end of a coordinator; `detail` is one line, or ''."""

    agent: str
    outcome: Literal["done", "died", "lost", "unknown"]
    detail: str


class _Host(Struct):
    """The data of one host, since it was reached in this incarnation; times on our monotonic clock.

    `waiting` are its coordinators that are not started. `started_at` is the start of the host.
    """

    is_linked: bool = False
    contact: float | None = None
    incarnation: int = 0
    latest: int = 0
    started_at: float = 0.0
    has_journal: bool = False
    starts: dict[Start, CoordinatorState] = field(default_factory=dict)
    #: The starts whose end was an event: it belongs to this run.
    ended_now: set[Start] = field(default_factory=set)
    waiting: frozenset[str] = frozenset()
    peers: set[str] = field(default_factory=set)


class MissionEnd:
    """One mission; `homes` has the home of each coordinator, None if only the hosts know the coordinators.

    Implements `StreamHandler`. `outcomes` are the ends of all coordinators, None as long as it runs.
    """

    def __init__(
        self, hosts: Sequence[str], homes: Mapping[str, str] | None, lost_after: float, clock: Clock
    ) -> None:
        self._hosts = {host: _Host() for host in hosts}
        self._homes, self._lost_after, self._clock = homes, lost_after, clock
        self._start = clock.monotonic()
        self._query_at = self._start
        #: The coordinators that all hosts have missed, with the number of queries in a row.
        self._missed = Counter[str]()
        self._coordinators: set[str] = set()
        self.outcomes: Sequence[CoordinatorEnd] | None = None

    def is_over(self) -> bool:
        """Whether the mission has ended."""
        return self.outcomes is not None

    # --- in -------------------------------------------------------------------------------------------

    def on_linked(self, host: str) -> None:
        """Has no effect: the first batch follows."""

    def on_unlinked(self, host: str, reason: str) -> None:
        """See `StreamHandler.on_unlinked`."""
        self._hosts[host].is_linked = False

    def on_batch(self, host: str, batch: EventBatch, took: float | None) -> None:
        """See `StreamHandler.on_batch`."""
        known = self._on_contact(host, batch)
        known.is_linked = True
        for event in batch.events:
            if event.number > known.latest and not isinstance(event.what, events.TelemetryEvent):
                known.latest = event.number
                self._on_event(known, event.what)
        if batch.snapshot is not None and batch.latest >= known.latest:
            self._on_snapshot(known, batch.snapshot, batch.latest)

    def on_answers(self, answers: Mapping[str, EventBatch | LfieldError]) -> None:
        """Handle the answers of the hosts to a query."""
        for host, answer in answers.items():
            if host in self._hosts and isinstance(answer, EventBatch) and answer.snapshot is not None:
                known = self._on_contact(host, answer)
                if answer.latest >= known.latest:
                    self._on_snapshot(known, answer.snapshot, answer.latest)
        now = self._clock.monotonic()
        has_all = all(isinstance(answers.get(host), EventBatch) for host in self._hosts)
        missing = {agent for agent in self._agents() if has_all and self._is_missing(agent)}
        self._missed = Counter({agent: self._missed[agent] + 1 for agent in missing})
        self._query_at = now + (SEARCH_INTERVAL if missing else QUERY_INTERVAL)

    def _on_contact(self, host: str, batch: EventBatch) -> _Host:
        now = self._clock.monotonic()
        known = self._hosts[host]
        if known.incarnation != batch.incarnation:
            # The data of an earlier incarnation are in its journal, or lost.
            is_linked = known.is_linked
            known = self._hosts[host] = _Host(is_linked=is_linked, incarnation=batch.incarnation)
            self._query_at = min(self._query_at, now)
        known.contact, known.started_at = now, now - batch.up
        return known

    def _on_snapshot(self, known: _Host, report: Status, latest: int) -> None:
        ends = {start: known.starts[start] for start in known.ended_now}
        known.starts = {(row.agent, row.generation): row for row in report.coordinators} | ends
        known.latest = latest
        known.has_journal = report.journal is not None
        known.waiting = frozenset(report.start.agents) if report.start is not None else frozenset()
        known.peers = {link.host for link in report.links if link.away is None}
        self._coordinators |= {row.agent for row in report.coordinators} | known.waiting
        self._coordinators |= {agent.id for agent in report.agents if agent.kind == "coordinator"}

    def _on_event(self, host: _Host, event: object) -> None:
        match event:
            case events.AgentStarted(agent, generation) | events.CoordinatorRecovered(agent, generation):
                _set(host, agent, generation, state="RUN")
                host.waiting -= {agent}
            case events.MigrationArrived(agent, generation, sequence) | events.MigrationFailed(
                agent, generation, sequence
            ):
                _set(host, agent, generation, state="RUN", sequence=sequence)
            case events.MigrationStarted(agent, generation, sequence, to):
                _set(host, agent, generation, state="PREPARED", where=to, sequence=sequence)
            case events.MigrationConfirmed(agent, generation, sequence, to):
                start = host.starts.get((agent, generation))
                # The coordinator may be back already.
                if start is None or (start.state == "PREPARED" and start.sequence == sequence):
                    _set(host, agent, generation, state="MOVED", where=to, sequence=sequence)
            case events.MigrationInDoubt(agent, generation, to):
                _set(host, agent, generation, state="IN DOUBT", where=to)
            case events.AgentFinished(agent, generation, how, detail):
                _set(host, agent, generation, state="EXITED", outcome=how, detail=detail)
                host.ended_now.add((agent, generation))
            case events.CoordinatorSuperseded(agent, generation, reason):
                _set(host, agent, generation, state="EXITED", outcome="superseded", detail=reason)
            case events.StartDelayed(agents):
                host.waiting = frozenset(filter(None, agents.split(", ")))
            case events.LinkUp(peer):
                host.peers.add(peer)
            case events.LinkDown(peer):
                host.peers.discard(peer)
            case _:
                pass

    # --- out ------------------------------------------------------------------------------------------

    @property
    def is_query_due(self) -> bool:
        """Whether to query all hosts now."""
        return self._clock.monotonic() >= self._query_at

    def check(self) -> None:
        """Evaluate the ends; called a few times a second."""
        ends = [self._end_of(agent) for agent in sorted(self._agents())]
        found = [end for end in ends if end is not None]
        if len(found) == len(ends) and self._has_contact and not self._has_others:
            self.outcomes = found

    @property
    def _has_others(self) -> bool:
        """Whether a coordinator is alive that another one has started: the mission lasts until it ends."""
        agents = self._agents()
        # Starts of coordinators count from 1; resources have none.
        return any(
            row.generation > 0 and row.agent not in agents and self._end_of(row.agent) is None
            for known in self._hosts.values()
            for row in known.starts.values()
        )

    def _agents(self) -> set[str]:
        return self._coordinators if self._homes is None else set(self._homes)

    @property
    def _has_contact(self) -> bool:
        """Whether enough hosts have answered to know the coordinators, or none will."""
        if all(self._is_lost(host) for host in self._hosts):
            return True
        answered = {host for host, known in self._hosts.items() if known.contact is not None}
        if self._homes is not None:
            return bool(answered)
        return bool(self._coordinators) and all(
            host in answered or self._is_lost(host) for host in self._hosts
        )

    def _end_of(self, agent: str) -> CoordinatorEnd | None:
        """The end of a coordinator; None while it is, or may be, alive on a host that is waited for."""
        starts = self._starts_of(agent)
        if any(self._is_alive(host, start) for host, start in starts):
            return None
        ends = {start.generation: start for _, start in starts if start.state == "EXITED"}
        lost: CoordinatorEnd | None = None
        for generation in sorted({start.generation for _, start in starts}, reverse=True):
            end = ends.get(generation)
            if end is None:
                break
            if end.outcome in TERMINATED:
                found = CoordinatorEnd(agent, "died" if end.outcome == "died" else "done", end.detail)
                return found if self._is_settled(agent, generation) else None
            lost = lost or CoordinatorEnd(agent, "lost", end.detail)
        return self._missing_end(agent, lost)

    def _starts_of(self, agent: str) -> list[tuple[str, CoordinatorState]]:
        """The states of a coordinator's starts on the hosts, without superseded ones; an end on one host
        is the end.
        """
        rows = [
            (host, row)
            for host, known in self._hosts.items()
            for row in known.starts.values()
            if row.agent == agent
        ]
        superseded = {row.generation for _, row in rows if row.outcome == "superseded"}
        ended = {row.generation for _, row in rows if row.outcome in TERMINATED}
        return [
            (host, row)
            for host, row in rows
            if row.generation not in superseded and (row.generation not in ended or row.outcome in TERMINATED)
        ]

    def _is_alive(self, host: str, start: CoordinatorState) -> bool:
        """Whether a start is alive as far as a reachable host knows."""
        if not self._hosts[host].is_linked:
            return False
        target = self._hosts.get(start.where)
        # A host that waits for the verdict of another one may still continue it.
        in_doubt = start.state == "IN DOUBT" and target is not None and target.is_linked
        return start.state in _ALIVE or in_doubt

    def _is_missing(self, agent: str) -> bool:
        """Whether a coordinator was started, has not ended, and is on no host."""
        starts = self._starts_of(agent)
        ended = any(start.outcome in TERMINATED for _, start in starts)
        return bool(starts) and not ended and not any(self._is_alive(*each) for each in starts)

    def _missing_end(self, agent: str, lost: CoordinatorEnd | None) -> CoordinatorEnd | None:
        """The end of a coordinator that is on no reachable host."""
        home = self._homes.get(agent) if self._homes is not None else None
        is_started = bool(self._starts_of(agent))
        if not is_started and home in self._hosts and self._hosts[home].is_linked:
            return None
        unreachable = [host for host, known in self._hosts.items() if not known.is_linked]
        if not unreachable and self._missed[agent] < LOST_QUERIES:
            return None
        if not unreachable:
            return lost or CoordinatorEnd(agent, "lost", "no host has it")
        if not all(self._is_lost(host) for host in unreachable):
            return None
        return lost or CoordinatorEnd(agent, "unknown", f"unreachable: {', '.join(unreachable)}")

    def _is_lost(self, host: str) -> bool:
        """Whether a host is not waited for any more: out of reach for long, also for the others."""
        known = self._hosts[host]
        if known.is_linked or any(other.is_linked and host in other.peers for other in self._hosts.values()):
            return False
        since = self._start if known.contact is None else known.contact
        return self._clock.monotonic() >= since + self._lost_after

    def _is_settled(self, agent: str, generation: int) -> bool:
        """Whether an end belongs to this run: its home would have started it again by now."""
        if any((agent, generation) in known.ended_now for known in self._hosts.values()):
            return True
        home = self._homes.get(agent) if self._homes is not None else None
        homes = [home] if home in self._hosts else list(self._hosts)
        return all(self._is_host_settled(host, agent) for host in homes if host is not None)

    def _is_host_settled(self, host: str, agent: str) -> bool:
        known = self._hosts[host]
        if not known.is_linked:
            return self._is_lost(host)
        is_late = self._clock.monotonic() >= known.started_at + SETTLE_TIME
        return agent not in known.waiting and (is_late or not known.has_journal)


def _set(known: _Host, agent: str, generation: int, **changes: object) -> None:
    """Change the state of a start on a host. An end is final."""
    start = known.starts.get((agent, generation)) or CoordinatorState(agent, generation, 0, 0, "RUN")
    if start.state != "EXITED" or changes["state"] == "EXITED":
        known.starts[agent, generation] = replace(start, **changes)

"""Outcome resolution: whether each coordinator has ended, is alive, is certainly lost, or is unreachable.

Every host records, for each coordinator, the number of the last transfer that it knows. The numbers only grow
along the coordinator's path, so the record with the highest number names its last location. A loss needs
proof: the host of the last location has exited, or has restarted without the coordinator, and no other host
can have it. Silence is no proof; the outcome is then "unheard".
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import msgspec
from msgspec import structs

from lfield.wire.coordinator_messages import TERMINATED, CoordinatorState

_ALIVE = ("RUN", "FROZEN", "PREPARED")


@dataclass(frozen=True, slots=True)
class CoordinatorOutcome:
    """The end of a coordinator: `outcome` is done, died, lost or unheard; `detail` is one line.

    `starts` are the lost generations, the latest first.
    """

    agent: str
    outcome: str
    detail: str
    starts: tuple[int, ...] = field(default=(), compare=False)


class UnavailableHosts(msgspec.Struct, frozen=True):
    """The hosts that did not answer a cluster query, and the state ids of the hosts that did.

    `ended`: certainly ended. `silent_for`: seconds of silence, longer than allowed. `reachable_by_others`:
    all other hosts, which some host can reach. `state_ids`: the journal ids of the hosts that answered.
    `has_journals`: the state of a host survives the host.
    """

    ended: Collection[str] = ()
    silent_for: Mapping[str, float] = msgspec.field(default_factory=dict)
    reachable_by_others: Collection[str] = ()
    state_ids: Mapping[str, int] = msgspec.field(default_factory=dict)
    has_journals: bool = False


StateRecords = Sequence[CoordinatorState]


def resolve_outcomes(
    homes: Mapping[str, str], records: Mapping[str, StateRecords], unavailable: UnavailableHosts
) -> dict[str, CoordinatorOutcome]:
    """The coordinators that have ended, are lost or are unheard.

    `homes` is the home host of each coordinator, `records` the records of each answering host. Hosts do not
    answer at the same moment: see `OutcomeResolver`.
    """
    found = {}
    for agent, home in homes.items():
        by_host = {host: [r for r in rows if r.agent == agent] for host, rows in records.items()}
        if outcome := _ClusterQuery(agent, by_host, unavailable).outcome(home):
            found[agent] = outcome
    return found


def local_outcomes(
    homes: Mapping[str, str], records: StateRecords, proven: Collection[str]
) -> dict[str, CoordinatorOutcome]:
    """The outcomes that a host knows from its own records, without a query.

    A lost record does not exclude a later start, so it counts only for coordinators that were `proven` lost
    now.
    """
    found = resolve_outcomes(homes, {"": records}, UnavailableHosts())
    return {
        agent: outcome
        for agent, outcome in found.items()
        if outcome.outcome in TERMINATED or (outcome.outcome == "lost" and agent in proven)
    }


class OutcomeResolver:
    """Compares two successive cluster queries, since answers from different moments can look like a loss.

    A copy in transit may be recorded as sent but not yet as received. If the next query finds the same
    transfer missing, its receiver cannot have accepted it after the first query. This class also stores the
    progress of each start, since the host that reported it may have ended.
    """

    def __init__(self, homes: Mapping[str, str]) -> None:
        self._homes = homes
        self._before: Mapping[str, CoordinatorOutcome] = {}
        self._newest: dict[tuple[str, int], CoordinatorState] = {}

    def resolve(
        self, records: Mapping[str, StateRecords], unavailable: UnavailableHosts
    ) -> dict[str, CoordinatorOutcome]:
        """The outcomes that are certain now."""
        remembered = {"": list(self._newest.values())}
        before, self._before = (
            self._before,
            resolve_outcomes(self._homes, {**remembered, **records}, unavailable),
        )
        for host, rows in records.items():
            for row in rows:
                self._note_state(_past_state(row, host, unavailable.state_ids.get(host, 0)))
        return {
            agent: outcome
            for agent, outcome in self._before.items()
            if _is_certain(outcome, before.get(agent))
        }

    def _note_state(self, row: CoordinatorState) -> None:
        key = row.agent, row.generation
        known = self._newest.get(key)
        if known is None or (known.state != "EXITED" and row.sequence >= known.sequence):
            self._newest[key] = row


def _past_state(row: CoordinatorState, host: str, state_id: int) -> CoordinatorState:
    """The meaning of a record at a later time: a copy that was alive on a host had arrived there."""
    if row.state not in _ALIVE:
        return row
    return structs.replace(row, state="MOVED", where=host, receiver_memory=state_id)


def _is_certain(outcome: CoordinatorOutcome, before: CoordinatorOutcome | None) -> bool:
    match outcome.outcome:
        case "lost":
            return before is not None and (outcome, outcome.starts) == (before, before.starts)
        case "unheard":
            return before is not None and before.outcome == "unheard"
        case _:
            return True


class _ClusterQuery:
    """The records of all answering hosts about one coordinator."""

    def __init__(
        self, agent: str, records: Mapping[str, StateRecords], unavailable: UnavailableHosts
    ) -> None:
        self.agent, self.records, self.unavailable = agent, records, unavailable

    def outcome(self, home: str) -> CoordinatorOutcome | None:
        """The outcome; None while the coordinator is or may be alive on a reachable host.

        One live start decides. Otherwise the latest start counts, and an earlier one only if the latest is
        lost.
        """
        rows = [row for known in self.records.values() for row in known]
        superseded = {row.generation for row in rows if row.outcome == "superseded"}
        starts = sorted({row.generation for row in rows} - superseded, reverse=True)
        ended = {row.generation: row for row in rows if row.state == "EXITED" and row.outcome != "lost"}
        if any(
            row.state in _ALIVE for row in rows if row.generation in starts and row.generation not in ended
        ):
            return None
        if not starts:
            return self._no_start_found(home, is_superseded=bool(superseded))
        found = [self._start(generation, ended.get(generation)) for generation in starts]
        outcome = next(
            (outcome for outcome in found if outcome is None or outcome.outcome != "lost"), found[0]
        )
        return replace(outcome, starts=tuple(starts)) if outcome and outcome.outcome == "lost" else outcome

    def _start(self, generation: int, ended: CoordinatorState | None) -> CoordinatorOutcome | None:
        return (
            CoordinatorOutcome(self.agent, ended.outcome, ended.detail)
            if ended
            else self._missing_start(generation)
        )

    def _no_start_found(self, home: str, *, is_superseded: bool) -> CoordinatorOutcome | None:
        """The outcome when no answering host knows a live start."""
        if is_superseded:
            return self._lost_unless_elsewhere("no host knows the start that superseded the others")
        if home in self.unavailable.ended:
            return self._lost_unless_elsewhere(f"its host {home} has ended")
        return (
            self._silent(home, f"it starts on {home}, and") if home in self.unavailable.silent_for else None
        )

    def _missing_start(self, generation: int) -> CoordinatorOutcome | None:
        """The outcome of a start that no answering host has, by its last known location."""
        rows_by_host = {
            host: [r for r in rows if r.generation == generation] for host, rows in self.records.items()
        }
        rows = [row for records in rows_by_host.values() for row in records]
        for row in rows:
            if row.state == "EXITED":
                # This start is proven lost; its home may have started the coordinator again since then.
                return self._lost_unless_elsewhere(row.detail)
        last = max(rows, key=lambda row: row.sequence)
        where, movement = last.where, f"it moved to {last.where} (transfer {last.sequence})"
        if where in self.unavailable.ended:
            return self._lost_unless_elsewhere(f"its last host {where} has ended")
        if where in self.unavailable.silent_for:
            return self._silent(where, f"{movement}, and")
        rows_there = rows_by_host.get(where)
        if rows_there is None or any(row.sequence >= last.sequence for row in rows_there):
            return None
        if self.unavailable.state_ids.get(where) == last.receiver_memory:
            # The start is in transit to that incarnation, or waits there for its devices.
            return None
        return self._lost_unless_elsewhere(f"{movement}, which was restarted")

    def _lost_unless_elsewhere(self, how: str) -> CoordinatorOutcome | None:
        """The outcome "lost", unless the coordinator may have moved on to a host that does not answer."""
        if self.unavailable.reachable_by_others:
            return None
        if self.unavailable.has_journals:
            return CoordinatorOutcome(
                self.agent, "unheard", f"{how}; it resumes from that host's journal when the host restarts"
            )
        if self.unavailable.silent_for:
            return self._silent(
                min(self.unavailable.silent_for), f"{how}, but it may have moved on from there, and"
            )
        return CoordinatorOutcome(self.agent, "lost", how)

    def _silent(self, host: str, how: str) -> CoordinatorOutcome:
        seconds = self.unavailable.silent_for[host]
        return CoordinatorOutcome(
            self.agent, "unheard", f"{how} {host} has been unreachable for {seconds:.0f} s"
        )

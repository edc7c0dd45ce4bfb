"""The runs of the startable coordinators of one home: whether a run is under way, how the last run ended, and
the next start. Pure.

A run begins with a start by the home. A recovery by another host continues it under a higher number, so the
newest known start of a coordinator is that of its last run.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from lfield.journal.records import SequenceRecord
from lfield.replication.transfer.generations import is_recovery, next_start
from lfield.replication.transfer.start_gate import StartGate
from lfield.vm.agent import STOPPED
from lfield.wire.coordinator_messages import TERMINAL, CoordinatorState

#: The outcome of a coordinator that was never started.
NEVER_STARTED = "not started"


class StartableRuns:
    """The runs of one coordinator. `others` are the other hosts of the team, `record` is its record, if
    there is one."""

    def __init__(self, agent: str, others: Collection[str], record: SequenceRecord | None) -> None:
        self.agent = agent
        #: The last start by this host, the request for it, and whether its end is ordered.
        self.record = record or SequenceRecord(agent)
        #: Whether a host reports the coordinator alive, and which hosts have not reported.
        self.gate = StartGate([agent], others)
        self._is_recorded = record is not None

    def open(self, *, is_known: bool, without: Collection[str]) -> None:
        """The other hosts had time to report; `is_known`: this host would have a record of a start."""
        self.gate.exclude(without)
        self.gate.open(self.record.generation if self._is_recorded else 0 if is_known else None, first=False)

    @property
    def missing(self) -> Sequence[str]:
        """The hosts that must report first, since a start may be alive there."""
        return [] if self._is_recorded else self.gate.missing

    def started_by(self, request: int) -> bool:
        """Whether the last start was made for this request."""
        return self._is_recorded and self.record.request == request

    def next_record(self, known: Iterable[CoordinatorState], fence: int, request: int) -> SequenceRecord:
        """The record of the next start, for a request; its number is above every known one."""
        self.gate.on_generations(known)
        self.gate.require_above(max(fence, self.record.generation))
        return SequenceRecord(self.agent, next_start(self.gate.newest), request)

    def on_recorded(self, record: SequenceRecord) -> None:
        """The record is written."""
        self.record, self._is_recorded = record, True

    # --- the last run ---------------------------------------------------------------------------------

    def _last(self, known: Iterable[CoordinatorState]) -> CoordinatorState | None:
        rows = (row for row in known if row.agent == self.agent)
        return max(rows, key=lambda row: row.generation, default=None)

    def where(self, known: Sequence[CoordinatorState]) -> str:
        """A short text about the location of the last run, as far as is known; '' if the run has ended."""
        last = self._last(known)
        if last is None or (last.state == "EXITED" and last.outcome in TERMINAL):
            return "on another host" if self.gate.is_alive(self.agent, known) else ""
        if last.state == "EXITED":
            return "on another host, which has recovered it"
        return f"at {last.where}" if last.state in ("MOVED", "PREPARED", "IN DOUBT") else "here"

    def outcome(self, known: Sequence[CoordinatorState]) -> str:
        """The outcome of the last run: done, stopped, failed or lost, with the reason."""
        last = self._last(known)
        if last is None or not (self.record.generation or last.generation):
            return NEVER_STARTED
        reason = next(iter(last.detail.splitlines()), "")
        if last.outcome == "done":
            return STOPPED if last.detail == STOPPED else "done"
        return f"{'failed' if last.outcome == 'died' else last.outcome}: {reason}"


def is_of_run(generation: int, first: int, generations: Iterable[int]) -> bool:
    """Whether a start belongs to the run that began with start `first`, as far as a host knows.

    `generations` are the starts of the coordinator that the host has records of. Recoveries continue the run
    until the home makes another start.
    """
    if generation == first:
        return True
    return (
        generation > first
        and is_recovery(generation)
        and not any(first < each <= generation and not is_recovery(each) for each in generations)
    )

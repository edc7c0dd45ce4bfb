"""Bugs of `start` and `stop`, as patches of the real code: a scenario must find each."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from lfield.host.sequencing.startable_runs import StartableRuns
from lfield.replication.transfer.core import Mobility
from lfield.replication.transfer.effects import Effect
from lfield.wire.coordinator_messages import CoordinatorState

Patch = pytest.MonkeyPatch


def a_request_starts_again_after_a_restart(patch: Patch) -> None:
    """The number of a request is ignored: it is executed again after a restart."""
    patch.setattr(StartableRuns, "started_by", lambda self, request: False)
    patch.setattr(StartableRuns, "where", lambda self, known: "")


def a_running_coordinator_is_started_again(patch: Patch) -> None:
    """A start does not check whether the last run has ended."""
    where = StartableRuns.where

    def forgetful(self: StartableRuns, known: Sequence[CoordinatorState]) -> str:
        found = where(self, known)
        return found if found == "here" else ""

    patch.setattr(StartableRuns, "where", forgetful)


def an_outdated_report_ends_the_next_run(patch: Patch) -> None:
    """A host that was down reports its copy of an ended run: the next run is superseded."""
    known = Mobility._on_state

    def naive(self: Mobility, host: str, state_id: int, row: CoordinatorState) -> list[Effect]:
        effects = known(self, host, state_id, row)
        if row.state in ("RUN", "FROZEN", "PREPARED"):
            effects += self._termination.compare_starts(host, row)
        return effects

    patch.setattr(Mobility, "_on_state", naive)


SEQUENCING_BUGS: tuple[Callable[[Patch], None], ...] = (
    a_request_starts_again_after_a_restart,
    a_running_coordinator_is_started_again,
    an_outdated_report_ends_the_next_run,
)

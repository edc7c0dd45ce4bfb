"""Plans the reset of a journal: the copies that it discards, and the reasons against it. Sans-IO.

`lfield up --fresh` starts another run. Copies on this host are discarded after a confirmation. Copies that
have left it belong to other hosts, which are queried.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from msgspec import structs

from lfield.journal.records import BundleRecord, CoordinatorRecord, Record, RunMarker
from lfield.operator.coordinator_location import parked_copies, records
from lfield.operator.team_model.team_state import HostState
from lfield.wire.coordinator_messages import Outcome

#: The reason, as sent to every host.
RESET_REASON = "thrown away by 'lfield up --fresh'"


class ResetPlan(NamedTuple):
    """The discarded copies, those that may be alive elsewhere, and the new records.

    `parked`: the host that keeps a discarded copy for another mission, and must release it.
    """

    discarded: Sequence[CoordinatorRecord]
    departed: Sequence[CoordinatorRecord]
    pages: Sequence[Record]
    parked: Mapping[CoordinatorRecord, str]


def departed(pages: Iterable[Record]) -> list[CoordinatorRecord]:
    """The copies that may be alive elsewhere."""
    copies = (page for page in pages if isinstance(page, CoordinatorRecord))
    return [page for page in copies if page.state in ("PREPARED", "MOVED")]


def plan_reset(host: str, pages: Sequence[Record], others: Mapping[str, HostState]) -> ResetPlan:
    """The reset after which the next start of a host is a new run; the counter of starts stays.

    `others` are the answers of the other hosts.
    """
    held = [page for page in pages if isinstance(page, CoordinatorRecord) and page.state == "RUN"]
    away, thrown, changed = list[CoordinatorRecord](), list(held), list[Record]()
    parked = dict[CoordinatorRecord, str]()
    for page in departed(pages):
        ending, where = _known_outcome(page, others), _parked(page, others)
        if ending is not None:
            changed.append(ending)
        elif where:
            parked[page] = where
        else:
            away.append(page)
    thrown += parked
    changed += [_ended(page, "lost", RESET_REASON, host) for page in thrown]
    bundle = [BundleRecord(b"") for page in pages if isinstance(page, BundleRecord)]
    return ResetPlan(thrown, away, [*changed, RunMarker(open=False), *bundle], parked)


def plan_discard(host: str, pages: Sequence[Record], reason: str) -> ResetPlan:
    """The reset that ends every coordinator of a journal; for a team of which every host does the same."""
    copies = [page for page in pages if isinstance(page, CoordinatorRecord) and page.state != "EXITED"]
    bundle = [BundleRecord(b"") for page in pages if isinstance(page, BundleRecord)]
    changed = [_ended(page, "lost", reason, host) for page in copies]
    return ResetPlan(copies, (), [*changed, RunMarker(open=False), *bundle], {})


def _known_outcome(page: CoordinatorRecord, others: Mapping[str, HostState]) -> CoordinatorRecord | None:
    """The end of a copy that migrated, if a host knows it."""
    for _, known in records(page.agent, others):
        if known.generation == page.generation and known.state == "EXITED":
            return _ended(page, known.outcome or "lost", known.detail, known.where)
    return None


def _parked(page: CoordinatorRecord, others: Mapping[str, HostState]) -> str:
    """The host that stores a migrated copy for another mission; '' for none."""
    copies = parked_copies(page.agent, others)
    return next(
        (where for where, one in copies if one.generation == page.generation and one.state == "RUN"), ""
    )


def _ended(page: CoordinatorRecord, outcome: Outcome, detail: str, host: str) -> CoordinatorRecord:
    """The same start, ended; sent by the host where it ended until all have confirmed."""
    return structs.replace(
        page, state="EXITED", outcome=outcome, detail=detail, ended_on=host, block=b"", program=b"", doubt=""
    )

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
    records: Sequence[Record]
    parked: Mapping[CoordinatorRecord, str]


def departed(stored: Iterable[Record]) -> list[CoordinatorRecord]:
    """The copies that may be alive elsewhere."""
    copies = (record for record in stored if isinstance(record, CoordinatorRecord))
    return [record for record in copies if record.state in ("PREPARED", "MOVED")]


def plan_reset(host: str, stored: Sequence[Record], others: Mapping[str, HostState]) -> ResetPlan:
    """The reset after which the next start of a host is a new run; the counter of starts stays.

    `others` are the answers of the other hosts.
    """
    held = [record for record in stored if isinstance(record, CoordinatorRecord) and record.state == "RUN"]
    departed_copies, discarded, changed = list[CoordinatorRecord](), list(held), list[Record]()
    parked = dict[CoordinatorRecord, str]()
    for record in departed(stored):
        exit_record, where = _known_outcome(record, others), _parked(record, others)
        if exit_record is not None:
            changed.append(exit_record)
        elif where:
            parked[record] = where
        else:
            departed_copies.append(record)
    discarded += parked
    changed += [_ended(record, "lost", RESET_REASON, host) for record in discarded]
    bundle = [BundleRecord(b"") for record in stored if isinstance(record, BundleRecord)]
    return ResetPlan(discarded, departed_copies, [*changed, RunMarker(open=False), *bundle], parked)


def plan_discard(host: str, stored: Sequence[Record], reason: str) -> ResetPlan:
    """The reset that ends every coordinator of a journal; for a team of which every host does the same."""
    copies = [
        record for record in stored if isinstance(record, CoordinatorRecord) and record.state != "EXITED"
    ]
    bundle = [BundleRecord(b"") for record in stored if isinstance(record, BundleRecord)]
    changed = [_ended(record, "lost", reason, host) for record in copies]
    return ResetPlan(copies, (), [*changed, RunMarker(open=False), *bundle], {})


def _known_outcome(record: CoordinatorRecord, others: Mapping[str, HostState]) -> CoordinatorRecord | None:
    """The end of a copy that migrated, if a host knows it."""
    for _, known in records(record.agent, others):
        if known.generation == record.generation and known.state == "EXITED":
            return _ended(record, known.outcome or "lost", known.detail, known.where)
    return None


def _parked(record: CoordinatorRecord, others: Mapping[str, HostState]) -> str:
    """The host that stores a migrated copy for another mission; '' for none."""
    copies = parked_copies(record.agent, others)
    return next(
        (where for where, copy in copies if copy.generation == record.generation and copy.state == "RUN"), ""
    )


def _ended(record: CoordinatorRecord, outcome: Outcome, detail: str, host: str) -> CoordinatorRecord:
    """The same start, ended; sent by the host where it ended until all have confirmed."""
    return structs.replace(
        record,
        state="EXITED",
        outcome=outcome,
        detail=detail,
        ended_on=host,
        block=b"",
        program=b"",
        doubt="",
    )

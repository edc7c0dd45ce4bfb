"""`lfield up --fresh`: prints the copies to discard, asks for confirmation, and closes the previous run."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.cli.confirmation import confirm
from lfield.errors import CoordinatorAlive, LfieldError, UsageError

if TYPE_CHECKING:
    from lfield.authority.key_material import Keys
    from lfield.journal.journal_loader import JournalOwner
    from lfield.journal.records import CoordinatorRecord
    from lfield.operator.client import HostAnswers
    from lfield.operator.journal_reset import ResetPlan
    from lfield.wire.observer_messages import ForgetResponse


def reset_journal(
    file: Path,
    owner: JournalOwner,
    others: Mapping[str, str],
    report: Callable[[str], None],
    keys: Keys | None,
    *,
    yes: bool,
) -> bool:
    """Whether the journal was made ready for a new run; False without confirmation.

    `others` are the addresses of the other hosts by name, queried with `keys`; `report` prints lines. Raises
    JournalError, CoordinatorAlive, UsageError.
    """
    import asyncio

    from lfield import event_loop
    from lfield.clock import SystemClock
    from lfield.journal.file_journal import FileJournal
    from lfield.operator.client import SNAPSHOT, ask_all, forget, observer_transport
    from lfield.operator.journal_reset import departed, plan_reset
    from lfield.operator.team_model.host_model import host_states

    journal = FileJournal(file, owner, report, SystemClock())
    try:
        records = journal.records()
        answers = (
            asyncio.run(ask_all(observer_transport(keys), others, SNAPSHOT)) if departed(records) else {}
        )
        found = plan_reset(owner.host, records, host_states(answers))
        if found.departed:
            raise CoordinatorAlive(_live_elsewhere(found.departed))
        if found.discarded and not _confirmed(owner.host, found, yes=yes):
            return False
        # First: a copy is given up there before it is discarded here.
        for record, where in found.parked.items():
            request = ask_all(observer_transport(keys), {where: others[where]}, forget(record.agent))
            _require_answer(record.agent, asyncio.run(request))
        event_loop.run(journal.persist(found.records))
        return True
    finally:
        journal.close()


def _require_answer(agent: str, answers: HostAnswers[ForgetResponse]) -> None:
    for where, answer in answers.items():
        if isinstance(answer, LfieldError):
            raise CoordinatorAlive(
                f"--fresh is refused: {where} stores {agent} for another mission, and has not given it up: "
                f"{answer}"
            )


def _live_elsewhere(departed_copies: Sequence[CoordinatorRecord]) -> str:
    record = departed_copies[0]
    return (
        f"--fresh is refused: {record.agent}, start {record.generation}, left for {record.target} (transfer "
        f"{record.sequence}) and may continue there; start {record.target} and try again, or end "
        f"{record.agent} where it is"
    )


def _confirmed(host: str, found: ResetPlan, *, yes: bool) -> bool:
    """Print the copies to discard and ask for confirmation. Raises UsageError without a terminal."""
    print(f"--fresh discards these coordinators of {host}, which could continue:")
    for record in found.discarded:
        where = f", parked at {found.parked[record]}" if record in found.parked else ""
        hops = f"{record.hops} hop{'s' * (record.hops != 1)}"
        print(f"  {record.agent}, start {record.generation}, after {hops}{where}")
    if yes:
        return True
    if not sys.stdin.isatty():
        raise UsageError("nothing was deleted: no terminal to confirm on; confirm with --yes")
    return confirm("Type 'yes' to discard them: ")

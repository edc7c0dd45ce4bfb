"""The journal interface, and the path of the journal of a host."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol
from urllib.parse import quote

from lfield.journal.records import Record, RecordKey
from lfield.text.user_dirs import state_dir


class Change(NamedTuple):
    """One change: records to write, in this order, then keys to delete."""

    records: Sequence[Record] = ()
    keys: Collection[RecordKey] = ()


class Journal(Protocol):
    """Stores records. Calls of `change`, `persist` and `delete` are committed in the order of the calls.

    No call blocks the event loop: calls during a commit become the next commit. When a commit fails, all
    queued calls also fail, so that no change is stored whose predecessor was lost. Each call is atomic.
    """

    @property
    def identity(self) -> int:
        """The random id of this journal.

        A journal that has lost records gets a new id: it cannot assert any more that an unknown transfer
        never arrived.
        """

    @property
    def problem(self) -> str:
        """The reason why no new coordinator should be admitted, '' if there is no reason.

        `persist` may succeed as long as reserved space is left.
        """

    def records(self) -> list[Record]:
        """All records, as read when the journal was opened."""

    @property
    def times(self) -> Mapping[RecordKey, float]:
        """The time when each record was written, in Unix time, in seconds."""

    async def change(self, changes: Sequence[Change]) -> None:
        """Make changes in order, all or none. Raises JournalError, as `persist`."""

    async def persist(self, records: Sequence[Record]) -> None:
        """Write records over those with the same keys; all are on disk when the method returns.

        Without records the method tests whether a journal in trouble can write again. Raises JournalError;
        then it is unknown whether the records are stored, and the call may be retried.
        """

    async def delete(self, keys: Collection[RecordKey]) -> None:
        """Delete records; missing keys are ignored. Raises JournalError."""

    def commits_last_minute(self, now: float) -> int:
        """The number of commits in the last 60 s; `now` is in seconds of the monotonic clock."""

    def close(self) -> None:
        """Close the journal so that the next start is quick. Finishes a commit under way; later calls
        fail.
        """


#: The file name in the folder of a host.
FILE_NAME = "host.journal"


def journal_file(folder: Path | None, deployment: str, host: str) -> Path:
    """The path of a host's journal: in the given folder, otherwise in the folder of the service or user.

    Raises NoHomeFolder.
    """
    place = f"{quote(deployment, safe='')}@{quote(host, safe='')}"
    return (folder or state_dir()) / place / FILE_NAME

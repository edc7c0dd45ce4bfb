"""What a journal promises, whoever keeps it; and where the one of a host lies."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol
from urllib.parse import quote

from lfield.journal.pages import Key, Page
from lfield.text.own_folders import state_folder


class Change(NamedTuple):
    """What one call asks for: pages to be written, in this order, and then keys to be forgotten."""

    pages: Sequence[Page] = ()
    keys: Collection[Key] = ()


class Journal(Protocol):
    """Keeps pages. Calls of `change`, `keep` and `forget` are committed in the order in which they were made.

    None ever waits on the loop: those that are called while a commit is under way become the next one.
    When a commit fails, so does all that was called before the failure is told: nothing is kept whose
    predecessor was lost. Each call is kept as a whole or not at all.
    """

    @property
    def identity(self) -> int:
        """The random number of this memory.

        One from which something was lost gets another: of a transfer that it does not know it cannot say any
        more that it never arrived.
        """

    @property
    def trouble(self) -> str:
        """Why nothing more should be taken in, '' when all is well.

        `keep` may succeed all the same, as long as the space lasts that was kept in advance.
        """

    def pages(self) -> list[Page]:
        """All pages, as they were read when it was opened."""

    @property
    def times(self) -> Mapping[Key, float]:
        """When each of these was kept, in Unix time, in seconds."""

    async def change(self, changes: Sequence[Change]) -> None:
        """Make changes in their order, all or none. Raises JournalError, as `keep`."""

    async def keep(self, pages: Sequence[Page]) -> None:
        """Write pages over those with the same keys; all are on the disk when it returns.

        Without pages it finds out whether the journal can keep again, once it was in trouble.
        Raises JournalError; then it is not known to be kept, and may be tried again.
        """

    async def forget(self, keys: Collection[Key]) -> None:
        """Remove pages for good; a key without one is none the worse. Raises JournalError."""

    def commits_last_minute(self, now: float) -> int:
        """How many commits there were in the last 60 s; `now` is in seconds, of its monotonic clock."""

    def close(self) -> None:
        """Leave it so that it is quickly opened. A commit under way is finished; nothing is kept after it."""


#: Its name in the folder of a host.
FILE_NAME = "host.journal"


def journal_file(folder: Path | None, deployment: str, host: str) -> Path:
    """Where the journal of a host is: in the folder that is named, else in the service's or the user's.

    Raises NoHome.
    """
    place = f"{quote(deployment, safe='')}@{quote(host, safe='')}"
    return (folder or state_folder()) / place / FILE_NAME

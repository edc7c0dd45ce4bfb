"""The disk of a simulated computer, with the journal of its host on it.

It takes its time, and may be full, broken, damaged or replaced. What is not committed when its process ends
is lost; of a commit that is under way then, either all or nothing is on the disk, as the dice want, for that
is what SQLite makes of a torn write. What a broken disk refused may be on it all the same. Not modelled: a
disk that says of something that it is kept and loses it, and one that can be read in part.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Sequence

from lfield.clock import Clock
from lfield.errors import JournalError
from lfield.journal.grouping import Grouped
from lfield.journal.journal import Change
from lfield.journal.opening import NO_RECORD, forgets, lost
from lfield.journal.pages import Entry, Key, Page, PageError, entry, page_of

#: Seconds until a commit is on a disk.
SYNC = 0.002
#: Commits for which a full disk has space that was kept in advance.
RESERVE = 20


class JournalDisk:
    """What stays when processes end. `dice` draw identities, and what becomes of a commit under way."""

    def __init__(self, dice: random.Random, sync: float = SYNC) -> None:
        self.dice = dice
        #: Seconds until a commit is on it, and while it is slow; how many a full one still takes.
        self.sync, self.slow, self.reserve = sync, 0.0, RESERVE
        #: Whether it has no room; whether it takes nothing.
        self.full = self.broken = False
        #: Of the journal on it, 0 until there is one.
        self.identity = 0
        self._entries: dict[Key, Entry] = {}

    def replace(self) -> None:
        """Another disk, empty and well: its journal will be another memory."""
        self.identity, self.reserve = 0, RESERVE
        self._entries.clear()
        self.full = self.broken = False

    def damage(self, key: Key) -> None:
        """Spoil a page, which is told when the journal is opened the next time."""
        found = self._entries[key]
        self._entries[key] = found._replace(check=found.check ^ 1)

    def open(self, clock: Clock, tell: Callable[[str], None]) -> SimulatedJournal:
        """The journal on it, for a process that has just begun. Raises JournalError for a broken disk."""
        self._see_that_it_works()
        pages = dict[Key, tuple[Entry, Page]]()
        for key, found in list(self._entries.items()):
            try:
                pages[key] = found, page_of(found)
            except PageError as error:
                del self._entries[key]
                self.identity = 0
                if forgets(found):
                    self._entries.pop(NO_RECORD, None)
                tell(f"{lost(found)}, is damaged in the journal ({error}); it was moved aside")
        pages = {key: found for key, found in pages.items() if key in self._entries}
        self.identity = self.identity or self.dice.getrandbits(63)
        return SimulatedJournal(self, self.identity, pages, clock)

    def pages(self) -> list[Page]:
        """What is on it, and would be there after a crash in this moment."""
        return [page_of(found) for found in self._entries.values()]

    def trouble(self) -> str:
        """What a host is told of it."""
        return "its disk is full" if self.full else ""

    def write(self, changes: Sequence[Change], now: float) -> None:
        """All changes at once, at a Unix time in seconds. Raises JournalError."""
        if self.full and not self.reserve:
            raise JournalError("of a simulation", "no space is left on its disk")
        self.reserve = self.reserve - 1 if self.full else RESERVE
        if not self.broken or self.dice.random() < 0.5:
            self._put(changes, now)
        # What could not be forced to the disk may be there all the same.
        self._see_that_it_works()

    def _put(self, changes: Sequence[Change], now: float) -> None:
        for pages, keys in changes:
            for page in pages:
                made = entry(page, now)
                self._entries[made.key] = made
            for key in keys:
                self._entries.pop(key, None)

    def _see_that_it_works(self) -> None:
        if self.broken:
            raise JournalError("of a simulation", "its disk fails")


class SimulatedJournal(Grouped):
    """See `Journal`: that of one life of a host, on the loop of its process."""

    def __init__(
        self, disk: JournalDisk, identity: int, pages: dict[Key, tuple[Entry, Page]], clock: Clock
    ) -> None:
        super().__init__(pages, self._commit, clock)
        self._disk, self.identity, self._clock = disk, identity, clock
        self.trouble = disk.trouble()
        self._closed = False

    def close(self) -> None:
        """See `Journal`."""
        self._closed = True

    async def _commit(self, changes: Sequence[Change]) -> None:
        if self._closed:
            raise JournalError("of a simulation", "it is closed")
        # Whoever dies between the two has kept it, and has told nobody.
        sync = max(self._disk.sync, self._disk.slow)
        before = self._disk.dice.uniform(0.0, sync)
        await asyncio.sleep(before)
        try:
            self._disk.write(changes, self._clock.time())
        except JournalError as error:
            self.trouble = error.reason
            raise
        self.trouble = self._disk.trouble()
        await asyncio.sleep(sync - before)

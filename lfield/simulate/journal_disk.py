"""The simulated disk of a computer, with the journal of its host.

The disk is slow, and may be full, broken, damaged or replaced. Uncommitted data is lost when the process
ends; a commit in progress is stored completely or not at all (random), as SQLite resolves a torn write. Data
refused by a broken disk may still be on it. Not modelled: a disk that loses acknowledged data, and partial
read errors.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Sequence

from lfield.clock import Clock
from lfield.errors import JournalError
from lfield.journal.group_commit import JournalBase
from lfield.journal.journal import Change
from lfield.journal.journal_loader import NO_RECORD, describe_loss, is_promise_lost
from lfield.journal.records import JournalEntry, Record, RecordError, RecordKey, decode_record, encode_record

#: Seconds per commit.
SYNC_TIME = 0.002
#: Commits for which a full disk has reserved space.
RESERVE = 20


class JournalDisk:
    """Disk contents that survive processes. `rng` draws identities, and the fate of a commit in progress."""

    def __init__(self, rng: random.Random, sync: float = SYNC_TIME) -> None:
        self.rng = rng
        #: Seconds per commit, also while slow; commits left on a full disk.
        self.sync, self.slow, self.reserve = sync, 0.0, RESERVE
        #: Whether the disk is full; whether it refuses writes.
        self.full = self.broken = False
        #: The id of the journal, 0 without one.
        self.identity = 0
        self._entries: dict[RecordKey, JournalEntry] = {}

    def replace(self) -> None:
        """Replace the disk by a working empty one: its journal gets another id."""
        self.identity, self.reserve = 0, RESERVE
        self._entries.clear()
        self.full = self.broken = False

    def damage(self, key: RecordKey) -> None:
        """Corrupt a page, which is detected when the journal is opened next."""
        found = self._entries[key]
        self._entries[key] = found._replace(checksum=found.checksum ^ 1)

    def open(self, clock: Clock, report: Callable[[str], None]) -> SimulatedJournal:
        """Open the journal for a new process. Raises JournalError on a broken disk."""
        self._check_usable()
        records = dict[RecordKey, tuple[JournalEntry, Record]]()
        for key, found in list(self._entries.items()):
            try:
                records[key] = found, decode_record(found)
            except RecordError as error:
                del self._entries[key]
                self.identity = 0
                if is_promise_lost(found):
                    self._entries.pop(NO_RECORD, None)
                report(f"{describe_loss(found)}, is damaged in the journal ({error}); it was moved aside")
        records = {key: found for key, found in records.items() if key in self._entries}
        self.identity = self.identity or self.rng.getrandbits(63)
        return SimulatedJournal(self, self.identity, records, clock)

    def records(self) -> list[Record]:
        """The contents of the disk after a crash now."""
        return [decode_record(found) for found in self._entries.values()]

    def problem(self) -> str:
        """The problem reported to a host."""
        return "its disk is full" if self.full else ""

    def write(self, changes: Sequence[Change], now: float) -> None:
        """Write all changes atomically, at a Unix time in seconds. Raises JournalError."""
        if self.full and not self.reserve:
            raise JournalError("of a simulation", "no space is left on its disk")
        self.reserve = self.reserve - 1 if self.full else RESERVE
        if not self.broken or self.rng.random() < 0.5:
            self._put(changes, now)
        # Data whose fsync failed may still be on the disk.
        self._check_usable()

    def _put(self, changes: Sequence[Change], now: float) -> None:
        for records, keys in changes:
            for record in records:
                entry = encode_record(record, now)
                self._entries[entry.key] = entry
            for key in keys:
                self._entries.pop(key, None)

    def _check_usable(self) -> None:
        if self.broken:
            raise JournalError("of a simulation", "its disk fails")


class SimulatedJournal(JournalBase):
    """See `Journal`: that of one incarnation of a host, on the loop of its process."""

    def __init__(
        self,
        disk: JournalDisk,
        identity: int,
        records: dict[RecordKey, tuple[JournalEntry, Record]],
        clock: Clock,
    ) -> None:
        super().__init__(records, self._commit, clock)
        self._disk, self.identity, self._clock = disk, identity, clock
        self.problem = disk.problem()
        self._closed = False

    def close(self) -> None:
        """See `Journal`."""
        self._closed = True

    async def _commit(self, changes: Sequence[Change]) -> None:
        if self._closed:
            raise JournalError("of a simulation", "it is closed")
        # A process that dies in between has stored it without acknowledgement.
        sync = max(self._disk.sync, self._disk.slow)
        before = self._disk.rng.uniform(0.0, sync)
        await asyncio.sleep(before)
        try:
            self._disk.write(changes, self._clock.time())
        except JournalError as error:
            self.problem = error.reason
            raise
        self.problem = self._disk.problem()
        await asyncio.sleep(sync - before)

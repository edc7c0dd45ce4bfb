"""Journal writes of a host: records in order, one commit at a time; a failed commit is retried."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress

from lfield.errors import JournalError
from lfield.event_loop import spawn
from lfield.host.effects import PersistRecords
from lfield.journal.journal import Change, Journal
from lfield.journal.records import Record, RecordKey, key_of

#: Seconds until a failed commit is retried.
RETRY_AFTER = 1.0
#: Seconds for which a stopping host waits for its disk.
CLOSE_TIMEOUT = 3.0


class JournalWriter:
    """The writer of one host: calls `on_durable(number)` after each commit, `on_write_failed(why)` after a
    failure.

    `on_space_changed(trouble)` is called when no more coordinators should be admitted, and with '' when
    coordinators may be admitted again.
    """

    def __init__(
        self,
        journal: Journal | None,
        on_durable: Callable[[int], None],
        on_write_failed: Callable[[str], None],
        on_space_changed: Callable[[str], None],
    ) -> None:
        self._journal, self._on_durable, self._on_write_failed, self._on_space_changed = (
            journal,
            on_durable,
            on_write_failed,
            on_space_changed,
        )
        self._problem = ""
        self._waiting: deque[PersistRecords] = deque()
        self._work: asyncio.Task[None] | None = None
        self._space_poller: asyncio.Task[None] | None = None

    @property
    def journal_id(self) -> int:
        """The id of the journal, 0 without one."""
        return self._journal.identity if self._journal else 0

    @property
    def records(self) -> list[Record]:
        """The records at the start."""
        return self._journal.records() if self._journal else []

    @property
    def times(self) -> Mapping[RecordKey, float]:
        """The time when each record was written, in Unix time, in seconds."""
        return self._journal.times if self._journal else {}

    @property
    def journal(self) -> Journal | None:
        """The journal; None without one."""
        return self._journal

    def delete(self, records: Collection[Record]) -> None:
        """Delete unneeded records; after a failure, the next start deletes them."""
        if records and self._journal:
            spawn(self._delete([key_of(record) for record in records], self._journal))

    async def _delete(self, keys: Collection[RecordKey], journal: Journal) -> None:
        with suppress(JournalError):
            await journal.delete(keys)

    def persist(self, batch: PersistRecords) -> None:
        """Write records, after the records of earlier calls."""
        self._waiting.append(batch)
        if self._work is None or self._work.done():
            self._work = spawn(self._write())

    async def _write(self) -> None:
        assert self._journal is not None
        while self._waiting:
            batches = list(self._waiting)
            try:
                await self._journal.change([Change(batch.records, batch.keys) for batch in batches])
            except JournalError as error:
                self.poll_disk_space()
                self._on_write_failed(str(error))
                await asyncio.sleep(RETRY_AFTER)
                continue
            for _ in batches:
                self._waiting.popleft()
            self._on_durable(batches[-1].number)
            self.poll_disk_space()

    def poll_disk_space(self) -> None:
        """Check the free space of the disk."""
        problem = self._journal.problem if self._journal else ""
        if problem != self._problem:
            self._problem = problem
            self._on_space_changed(problem)
        if problem and (self._space_poller is None or self._space_poller.done()):
            self._space_poller = spawn(self._wait_for_space())

    async def _wait_for_space(self) -> None:
        assert self._journal is not None
        while self._journal.problem:
            await asyncio.sleep(RETRY_AFTER)
            with suppress(JournalError):
                await self._journal.persist([])
        self.poll_disk_space()

    async def flush(self, bound: float | None = None) -> bool:
        """Wait until all pending records are on disk, at most `bound` seconds; returns whether they are on
        disk.
        """
        waited = list(self._waiting)
        if self._work is not None:
            await asyncio.wait([self._work], timeout=bound)
        return not any(batch is other for batch in waited for other in self._waiting)

    async def close(self) -> None:
        """Close the journal so that the next start is quick."""
        await self.flush(CLOSE_TIMEOUT)
        for task in (self._work, self._space_poller):
            if task is not None:
                task.cancel()
        if self._journal is not None:
            self._journal.close()

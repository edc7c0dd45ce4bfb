"""Group commit of journal writes: changes that arrive during a commit become the next one."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence

from lfield.clock import Clock
from lfield.journal.journal import Change
from lfield.journal.records import JournalEntry, Record, RecordKey

#: Commits changes atomically, in order. Raises JournalError.
Commit = Callable[[Sequence[Change]], Awaitable[None]]

MINUTE = 60.0


class GroupCommit:
    """The commit queue of a disk: all changes of one turn of the event loop are one commit."""

    def __init__(self, commit: Commit, clock: Clock) -> None:
        self._commit, self._clock = commit, clock
        self._waiting: list[tuple[Sequence[Change], asyncio.Future[None]]] = []
        self._runner: asyncio.Task[None] | None = None
        self._commits: deque[float] = deque()

    async def submit(self, *changes: Change) -> None:
        """Return when the changes are durable. Raises JournalError."""
        loop = asyncio.get_running_loop()
        result = loop.create_future()
        self._waiting.append((changes, result))
        if self._runner is None:
            self._runner = loop.create_task(self._run())
        await result

    def commits_per_minute(self, now: float) -> int:
        """The number of successful commits in the minute before `now`."""
        while self._commits and self._commits[0] <= now - MINUTE:
            self._commits.popleft()
        return len(self._commits)

    async def _run(self) -> None:
        try:
            while self._waiting:
                await self._commit_next()
        finally:
            self._runner = None

    async def _commit_next(self) -> None:
        group, self._waiting = self._waiting, []
        try:
            await self._commit([change for changes, _ in group for change in changes])
        except asyncio.CancelledError:
            for _, result in (*group, *self._waiting):
                result.cancel()
            raise
        except Exception as error:
            # Changes that were queued during the commit may depend on the failed ones.
            failed, self._waiting = (*group, *self._waiting), []
            for _, result in failed:
                if not result.done():
                    result.set_exception(error)
            return
        now = self._clock.monotonic()
        self._commits.append(now)
        self.commits_per_minute(now)
        for _, result in group:
            if not result.done():
                result.set_result(None)


class JournalBase:
    """Common part of all journals: `read` are the stored records, `commit` writes changes to the disk."""

    def __init__(
        self, read: Mapping[RecordKey, tuple[JournalEntry, Record]], commit: Commit, clock: Clock
    ) -> None:
        self._read = [record for _, record in read.values()]
        self.times = {key: entry.written_at for key, (entry, _) in read.items()}
        self._group_commit = GroupCommit(commit, clock)

    def records(self) -> list[Record]:
        """See `Journal`."""
        return self._read

    async def change(self, changes: Sequence[Change]) -> None:
        """See `Journal`."""
        await self._group_commit.submit(*changes)

    async def persist(self, records: Sequence[Record]) -> None:
        """See `Journal`."""
        await self._group_commit.submit(Change(records))

    async def delete(self, keys: Collection[RecordKey]) -> None:
        """See `Journal`."""
        await self._group_commit.submit(Change((), keys))

    def commits_last_minute(self, now: float) -> int:
        """See `Journal`."""
        return self._group_commit.commits_per_minute(now)

"""One commit at a time: what is asked for while one is under way becomes the next one."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Collection, Mapping, Sequence

from lfield.clock import Clock
from lfield.journal.journal import Change
from lfield.journal.pages import Entry, Key, Page

#: Brings changes to the disk, all or none, in their order. Raises JournalError.
Commit = Callable[[Sequence[Change]], Awaitable[None]]

MINUTE = 60.0


class Grouping:
    """The queue before a disk. All changes of one turn of the loop are one commit."""

    def __init__(self, commit: Commit, clock: Clock) -> None:
        self._commit, self._clock = commit, clock
        self._waiting: list[tuple[Sequence[Change], asyncio.Future[None]]] = []
        self._runner: asyncio.Task[None] | None = None
        self._commits: deque[float] = deque()

    async def ask(self, *changes: Change) -> None:
        """Return when the changes are on the disk; nobody else waits for it. Raises JournalError."""
        loop = asyncio.get_running_loop()
        kept = loop.create_future()
        self._waiting.append((changes, kept))
        if self._runner is None:
            self._runner = loop.create_task(self._run())
        await kept

    def last_minute(self, now: float) -> int:
        """How many commits succeeded in the minute before `now`."""
        while self._commits and self._commits[0] <= now - MINUTE:
            self._commits.popleft()
        return len(self._commits)

    async def _run(self) -> None:
        try:
            while self._waiting:
                await self._next()
        finally:
            self._runner = None

    async def _next(self) -> None:
        group, self._waiting = self._waiting, []
        try:
            await self._commit([change for changes, _ in group for change in changes])
        except asyncio.CancelledError:
            for _, kept in (*group, *self._waiting):
                kept.cancel()
            raise
        except Exception as error:
            # What was asked for meanwhile may build on what has failed.
            failed, self._waiting = (*group, *self._waiting), []
            for _, kept in failed:
                if not kept.done():
                    kept.set_exception(error)
            return
        now = self._clock.monotonic()
        self._commits.append(now)
        self.last_minute(now)
        for _, kept in group:
            if not kept.done():
                kept.set_result(None)


class Grouped:
    """What all journals do alike: `read` is what was kept before, `commit` brings changes to the disk."""

    def __init__(self, read: Mapping[Key, tuple[Entry, Page]], commit: Commit, clock: Clock) -> None:
        self._read = [page for _, page in read.values()]
        self.times = {key: entry.kept for key, (entry, _) in read.items()}
        self._grouping = Grouping(commit, clock)

    def pages(self) -> list[Page]:
        """See `Journal`."""
        return self._read

    async def change(self, changes: Sequence[Change]) -> None:
        """See `Journal`."""
        await self._grouping.ask(*changes)

    async def keep(self, pages: Sequence[Page]) -> None:
        """See `Journal`."""
        await self._grouping.ask(Change(pages))

    async def forget(self, keys: Collection[Key]) -> None:
        """See `Journal`."""
        await self._grouping.ask(Change((), keys))

    def commits_last_minute(self, now: float) -> int:
        """See `Journal`."""
        return self._grouping.last_minute(now)

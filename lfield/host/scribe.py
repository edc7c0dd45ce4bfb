"""Has pages put into the journal, one commit after the other; what fails is tried again until it succeeds."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress

from lfield.errors import JournalError
from lfield.host.effects import Keep
from lfield.journal.journal import Change, Journal
from lfield.journal.pages import Key, Page, key_of
from lfield.loop import spawn

#: Seconds after which a disk that could keep nothing is tried again.
AGAIN = 1.0
#: For so long an ending host waits for its disk, in seconds.
LAST_WORDS = 3.0


class Scribe:
    """Keeps for one host: `kept(number)` is told of what is on the disk, `not_kept(why)` of what is not.

    `room(trouble)` is told when nothing more should be taken in, and with '' when it may be again.
    """

    def __init__(
        self,
        journal: Journal | None,
        kept: Callable[[int], None],
        not_kept: Callable[[str], None],
        room: Callable[[str], None],
    ) -> None:
        self._journal, self._kept, self._not_kept, self._room = journal, kept, not_kept, room
        self._trouble = ""
        self._waiting: deque[Keep] = deque()
        self._work: asyncio.Task[None] | None = None
        self._watch: asyncio.Task[None] | None = None

    @property
    def memory(self) -> int:
        """The identity of the journal, 0 without one."""
        return self._journal.identity if self._journal else 0

    @property
    def pages(self) -> list[Page]:
        """What was kept before."""
        return self._journal.pages() if self._journal else []

    @property
    def times(self) -> Mapping[Key, float]:
        """When each of these was kept, in Unix time, in seconds."""
        return self._journal.times if self._journal else {}

    @property
    def journal(self) -> Journal | None:
        """Where it keeps them."""
        return self._journal

    def forget(self, pages: Collection[Page]) -> None:
        """Remove pages that nobody needs; if it fails, the next start does it."""
        if pages and self._journal:
            spawn(self._forget([key_of(page) for page in pages], self._journal))

    async def _forget(self, keys: Collection[Key], journal: Journal) -> None:
        with suppress(JournalError):
            await journal.forget(keys)

    def keep(self, batch: Keep) -> None:
        """Put pages on the disk, after those before."""
        self._waiting.append(batch)
        if self._work is None or self._work.done():
            self._work = spawn(self._write())

    async def _write(self) -> None:
        assert self._journal is not None
        while self._waiting:
            batches = list(self._waiting)
            try:
                await self._journal.change([Change(batch.pages, batch.keys) for batch in batches])
            except JournalError as error:
                self.look()
                self._not_kept(str(error))
                await asyncio.sleep(AGAIN)
                continue
            for _ in batches:
                self._waiting.popleft()
            self._kept(batches[-1].number)
            self.look()

    def look(self) -> None:
        """See whether there is room on the disk."""
        trouble = self._journal.trouble if self._journal else ""
        if trouble != self._trouble:
            self._trouble = trouble
            self._room(trouble)
        if trouble and (self._watch is None or self._watch.done()):
            self._watch = spawn(self._wait_for_room())

    async def _wait_for_room(self) -> None:
        assert self._journal is not None
        while self._journal.trouble:
            await asyncio.sleep(AGAIN)
            with suppress(JournalError):
                await self._journal.keep([])
        self.look()

    async def all_kept(self, bound: float | None = None) -> bool:
        """Return when nothing waits for the disk, or after so many seconds: whether all that did is on it."""
        waited = list(self._waiting)
        if self._work is not None:
            await asyncio.wait([self._work], timeout=bound)
        return not any(batch is one for batch in waited for one in self._waiting)

    async def close(self) -> None:
        """Leave the journal so that it is quickly opened again."""
        await self.all_kept(LAST_WORDS)
        for task in (self._work, self._watch):
            if task is not None:
                task.cancel()
        if self._journal is not None:
            self._journal.close()

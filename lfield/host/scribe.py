"""Has pages put into the journal, one commit after the other; what fails is tried again until it succeeds."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

from lfield.errors import JournalError
from lfield.host.effects import Keep
from lfield.journal.journal import Journal
from lfield.journal.pages import Page
from lfield.loop import spawn

#: Seconds after which a disk that could keep nothing is tried again.
AGAIN = 1.0
#: For so long an ending host waits for its disk, in seconds.
LAST_WORDS = 3.0


class Scribe:
    """Keeps for one host: `kept(number)` is told of what is on the disk, `not_kept(why)` of what is not."""

    def __init__(
        self,
        journal: Journal | None,
        kept: Callable[[int], None],
        not_kept: Callable[[str], None],
    ) -> None:
        self._journal, self._kept, self._not_kept = journal, kept, not_kept
        self._waiting: deque[Keep] = deque()
        self._work: asyncio.Task[None] | None = None

    @property
    def memory(self) -> int:
        """The identity of the journal, 0 without one."""
        return self._journal.identity if self._journal else 0

    @property
    def pages(self) -> list[Page]:
        """What was kept before."""
        return self._journal.pages() if self._journal else []

    @property
    def journal(self) -> Journal | None:
        """Where it keeps them."""
        return self._journal

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
                await self._journal.keep([page for batch in batches for page in batch.pages])
            except JournalError as error:
                self._not_kept(str(error))
                await asyncio.sleep(AGAIN)
                continue
            for _ in batches:
                self._waiting.popleft()
            self._kept(batches[-1].number)

    async def all_kept(self, bound: float | None = None) -> None:
        """Return when nothing waits for the disk, or after so many seconds."""
        if self._work is not None:
            await asyncio.wait([self._work], timeout=bound)

    async def close(self) -> None:
        """Leave the journal so that it is quickly opened again."""
        await self.all_kept(LAST_WORDS)
        if self._work is not None:
            self._work.cancel()
        if self._journal is not None:
            self._journal.close()

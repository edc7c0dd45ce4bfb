"""What a host finds in its journal at its start, and what waits for that journal later. Pure.

Effects of one coordinator keep their order, so what was decided later never overtakes what it rests on; other
coordinators do not wait. Pages that nothing depends on go along with the next ones that something does.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from lfield.journal.pages import CopyPage, Key, Page, ProgramPage, Run, Starts, key_of
from lfield.mobility.effects import Effect, Note, Persist, Send, SendTransfer
from lfield.wire.messages import Known

#: The longest that a page waits for company, in seconds.
SOON = 1.0


#: Of so many starts of each coordinator it is remembered how they ended; every run makes one.
ENDINGS = 8


class Keeping:
    """The pages and effects of one host that are waiting. `first` goes along with the first that are due."""

    def __init__(self, first: Iterable[Page] = ()) -> None:
        self._pages: dict[Key, Page] = {key_of(page): page for page in first}
        #: The number of the batch that pages go into now.
        self._number = 1
        self._behind: dict[str, deque[tuple[int, Effect]]] = {}
        self._urgent = False
        #: When pages that could wait are to be given, None without any; seconds on the host's clock.
        self.due: float | None = None

    def put(self, effects: Iterable[Effect], now: float) -> list[Effect]:
        """Effects of mobility, in their order: those that need not wait."""
        ready: list[Effect] = []
        for effect in effects:
            if isinstance(effect, Persist):
                self.page(effect.page, now, soon=effect.soon)
                if not effect.soon:
                    self._behind.setdefault(effect.agent, deque()).append((self._number, effect))
            elif waiting := self._behind.get(_agent(effect)):
                waiting.append((waiting[-1][0], effect))
            else:
                ready.append(effect)
        return ready

    def holds_back(self, agent: str) -> bool:
        """Whether something that a coordinator has to do waits for the disk."""
        return agent in self._behind

    def page(self, page: Page, now: float, *, soon: bool = False) -> int:
        """A page to keep; the number of its batch."""
        self._pages[key_of(page)] = page
        self._urgent = self._urgent or not soon
        if self.due is None:
            self.due = now + SOON
        return self._number

    def take(self, now: float) -> tuple[int, list[Page]] | None:
        """The next batch, if one is due."""
        if not self._pages or not (self._urgent or (self.due is not None and now >= self.due)):
            return None
        pages, self._pages = list(self._pages.values()), {}
        number, self._number = self._number, self._number + 1
        self._urgent, self.due = False, None
        return number, pages

    def kept(self, number: int) -> list[Effect]:
        """All batches up to this one are on the disk: what need not wait any more."""
        ready: list[Effect] = []
        for agent, waiting in list(self._behind.items()):
            while waiting and waiting[0][0] <= number:
                _, effect = waiting.popleft()
                if not isinstance(effect, Persist):
                    ready.append(effect)
            if not waiting:
                del self._behind[agent]
        return ready


class Recovery:
    """The pages of a host's journal; `mission` is the hash of what it runs now (`Hello.mission`).

    A coordinator of another mission stays parked: it waits for its own program and deployment.
    """

    def __init__(self, pages: Iterable[Page], mission: bytes) -> None:
        pages = list(pages)
        copies = [page for page in pages if isinstance(page, CopyPage)]
        #: Starts that ended so long ago that nobody asks any more.
        self.outdated = _outdated(copies)
        old = {key_of(page) for page in self.outdated}
        self.copies = [
            page for page in copies if key_of(page) not in old and (not page.block or page.program == mission)
        ]
        #: What belongs to another program or deployment.
        self.parked = [page for page in copies if page.block and page.program != mission]
        #: Whether there is what explains the blocks of this mission.
        self.explained = any(isinstance(page, ProgramPage) and page.digest == mission for page in pages)
        #: The last start that was made here, None when none is on record.
        self.starts = next((page.count for page in pages if isinstance(page, Starts)), None)
        #: Whether the run that was begun here earlier goes on.
        self.goes_on = any(page.open for page in pages if isinstance(page, Run))

    def why_not(self, agent: str, known: Iterable[Known]) -> str:
        """Why a coordinator of this host is not started anew, '' if nothing is against it."""
        rows = [row for row in known if row.agent == agent]
        if any(page.agent == agent for page in self.parked):
            return "waits for the program and deployment that it belongs to"
        for row in rows:
            if row.state in ("FROZEN", "PREPARED", "IN DOUBT", "MOVED"):
                return f"went to {row.where}"
            if row.state == "RUN":
                return "goes on"
        last = max(rows, key=lambda row: row.generation, default=None)
        # An earlier one ended in an earlier run: the start that is on record was not made.
        if last and self.goes_on and last.generation >= (self.starts or 0):
            return f"has ended ({last.outcome}) in the run that goes on here; --fresh begins another one"
        return ""


def _outdated(copies: Iterable[CopyPage]) -> list[CopyPage]:
    """The endings of each coordinator but the last few."""
    found: dict[str, list[CopyPage]] = {}
    for page in copies:
        if page.state == "EXITED":
            found.setdefault(page.agent, []).append(page)
    return [
        page
        for pages in found.values()
        for page in sorted(pages, key=lambda page: page.generation)[:-ENDINGS]
    ]


def _agent(effect: Effect) -> str:
    """The coordinator that an effect is about."""
    match effect:
        case Send():
            return getattr(effect.message, "agent", "")
        case SendTransfer():
            return effect.header.agent
        case Note():
            return ""
        case _:
            return effect.agent

"""What waits for the journal: effects on a coordinator that come after a page of it. Pure.

Effects of one coordinator keep their order, so what was decided later never overtakes what it rests on; other
coordinators do not wait. Pages that nothing depends on go along with the next ones that something does.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from lfield.journal.pages import Key, Page, key_of
from lfield.mobility.effects import Effect, Note, Persist, Send, SendTransfer

#: The longest that a page waits for company, in seconds.
SOON = 1.0


class Keeping:
    """The pages and effects of one host that are waiting."""

    def __init__(self) -> None:
        self._pages: dict[Key, Page] = {}
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

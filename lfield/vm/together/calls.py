"""The calls that were begun on this host: what became of them, and who hears of it (decision 46)."""

from __future__ import annotations

from collections.abc import Iterable

from lfield.vm.begun import Begun, Key
from lfield.vm.scheduler import Scheduler


class BegunCalls:
    """Keeps `scheduler.begun`: from the beginning of a call until its coordinator has fetched it."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler

    def kept(self, key: Key) -> None:
        """What came back is kept: whoever waits here for it goes on."""
        begun = self._scheduler.begun.get(key)
        if begun is None or begun.kept:
            return
        begun.kept = True
        waiter, begun.waiter = begun.waiter, None
        if waiter is not None:
            self._scheduler.turns.next(*waiter)

    def restore(self, calls: Iterable[Begun]) -> None:
        """What the host has kept in an earlier life: what ran then is lost."""
        for begun in calls:
            begun.kept = True
            if begun.state == "running":
                begun.state = "lost"
            self._scheduler.begun[begun.key] = begun

    def forget(self, keys: Iterable[Key]) -> None:
        """Nobody will fetch them."""
        for key in keys:
            if begun := self._scheduler.begun.pop(key, None):
                begun.dropped = True

"""I5: at every moment some disk holds a state from which a coordinator can continue, unless it ended.

A disk counts with the records that a starting host would read.
"""

from __future__ import annotations

from collections.abc import Iterable

from lfield.journal.records import CoordinatorRecord, Record


def is_saved(page: Record) -> bool:
    """True if a record is enough to continue. A copy without a block has made no call, and starts again."""
    if not isinstance(page, CoordinatorRecord):
        return False
    if page.state == "EXITED":
        return page.outcome != "lost"
    return page.state == "RUN" or (page.state == "PREPARED" and bool(page.block))


def unsaved_starts(pages: Iterable[Record], starts: Iterable[tuple[str, int]]) -> list[tuple[str, int]]:
    """The starts of coordinators without a state on any disk; `pages` are the records of all disks."""
    held = {
        (page.agent, page.generation)
        for page in pages
        if isinstance(page, CoordinatorRecord) and is_saved(page)
    }
    return [start for start in starts if start not in held]


def is_shadowed(agent: str, pages: Iterable[Record]) -> bool:
    """Whether any of these records is enough for a majority to recover a coordinator."""
    own = [page for page in pages if isinstance(page, CoordinatorRecord) and page.agent == agent]
    return any(page.state != "EXITED" and (page.block or page.state == "RUN") for page in own)


def last_location(start: tuple[str, int], pages: Iterable[Record]) -> CoordinatorRecord | None:
    """The record with the last known place of a start, None without any: the higher number counts.

    A receiver has a transfer under the number of its sender.
    """
    own = [
        page
        for page in pages
        if isinstance(page, CoordinatorRecord) and (page.agent, page.generation) == start
    ]
    went = [page for page in own if page.state in ("RUN", "PREPARED")]
    return max(went, key=lambda page: (page.sequence, page.state == "RUN"), default=None)

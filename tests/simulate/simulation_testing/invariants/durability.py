"""I5: at every moment some disk holds a state from which a coordinator can go on, unless it ended.

What is asked of a disk is what it would give to a host that began now.
"""

from __future__ import annotations

from collections.abc import Iterable

from lfield.journal.records import CoordinatorRecord, Record


def is_saved(page: Record) -> bool:
    """Whether a page is enough to go on from. A copy without a block has called nothing, and begins again."""
    if not isinstance(page, CoordinatorRecord):
        return False
    if page.state == "EXITED":
        return page.outcome != "lost"
    return page.state == "RUN" or (page.state == "PREPARED" and bool(page.block))


def unsaved_starts(pages: Iterable[Record], starts: Iterable[tuple[str, int]]) -> list[tuple[str, int]]:
    """The starts of coordinators of which no disk holds a state; `pages` are those of all disks."""
    held = {
        (page.agent, page.generation)
        for page in pages
        if isinstance(page, CoordinatorRecord) and is_saved(page)
    }
    return [start for start in starts if start not in held]


def is_shadowed(agent: str, pages: Iterable[Record]) -> bool:
    """Whether any of these pages is enough for a majority to go on with a coordinator."""
    own = [page for page in pages if isinstance(page, CoordinatorRecord) and page.agent == agent]
    return any(page.state != "EXITED" and (page.block or page.state == "RUN") for page in own)


def last_location(start: tuple[str, int], pages: Iterable[Record]) -> CoordinatorRecord | None:
    """The page that says where a start of a coordinator went last, None without any: the later number counts.

    Who has taken a transfer has it under the number that its sender gave it.
    """
    own = [
        page
        for page in pages
        if isinstance(page, CoordinatorRecord) and (page.agent, page.generation) == start
    ]
    went = [page for page in own if page.state in ("RUN", "PREPARED")]
    return max(went, key=lambda page: (page.sequence, page.state == "RUN"), default=None)

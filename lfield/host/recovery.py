"""What a host finds in its journal when it starts: what goes on, what stays as it is, and why. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from lfield.journal.pages import CopyPage, Page, Run, Starts
from lfield.wire.messages import Known


class Recovery:
    """The pages of a host's journal; `program` is the digest of what it runs now.

    A coordinator of another program stays parked: what is kept of it waits for that program.
    """

    def __init__(self, pages: Iterable[Page], program: bytes) -> None:
        pages = list(pages)
        copies = [page for page in pages if isinstance(page, CopyPage)]
        self.copies = [page for page in copies if not page.block or page.program == program]
        #: What belongs to another program.
        self.parked = [page for page in copies if page.block and page.program != program]
        #: The last start that was made here, None when none is on record.
        self.starts = next((page.count for page in pages if isinstance(page, Starts)), None)
        #: Whether the run that was begun here earlier goes on.
        self.goes_on = any(page.open for page in pages if isinstance(page, Run))

    def why_not(self, agent: str, known: Iterable[Known]) -> str:
        """Why a coordinator of this host is not started anew, '' if nothing is against it."""
        rows = [row for row in known if row.agent == agent]
        if any(page.agent == agent for page in self.parked):
            return "waits for the program that it belongs to"
        for row in rows:
            if row.state in ("FROZEN", "PREPARED", "IN DOUBT", "MOVED"):
                return f"went to {row.where}"
            if row.state == "RUN":
                return "goes on"
        if rows and self.goes_on:
            last = max(rows, key=lambda row: row.generation)
            return f"has ended ({last.outcome}) in the run that goes on here; --fresh begins another one"
        return ""

"""`lfield up --fresh`: names what a host throws away of its journal, asks, and closes the run of before."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.cli.yes import says_yes
from lfield.errors import CoordinatorAlive, LfieldError, UsageError

if TYPE_CHECKING:
    from lfield.authority.keys import Keys
    from lfield.journal.opening import Owner
    from lfield.journal.pages import CopyPage
    from lfield.operator.ask import Answers
    from lfield.operator.fresh import Anew
    from lfield.wire.observing import Forgotten


def begun_anew(
    file: Path,
    owner: Owner,
    others: Mapping[str, str],
    tell: Callable[[str], None],
    keys: Keys | None,
    *,
    yes: bool,
) -> bool:
    """Whether the journal was made ready for a new run; False when the person does not want it.

    `others` are the addresses of the other hosts by name, who are asked with `keys`; `tell` takes lines for
    people. Raises JournalError, CoordinatorAlive, UsageError.
    """
    import asyncio

    from lfield import loop
    from lfield.clock import SystemClock
    from lfield.journal.file import FileJournal
    from lfield.operator.ask import STATUS, ask_all, forget, observer
    from lfield.operator.fresh import anew, left

    journal = FileJournal(file, owner, tell, SystemClock())
    try:
        pages = journal.pages()
        answers = asyncio.run(ask_all(observer(keys), others, STATUS)) if left(pages) else {}
        found = anew(owner.host, pages, answers)
        if found.away:
            raise CoordinatorAlive(_in_the_way(found.away))
        if found.thrown and not _agreed(owner.host, found, yes=yes):
            return False
        # First: what is not given up there is not thrown away here.
        for page, where in found.parked.items():
            word = ask_all(observer(keys), {where: others[where]}, forget(page.agent))
            _insist_on_an_answer(page.agent, asyncio.run(word))
        loop.run(journal.keep(found.pages))
        return True
    finally:
        journal.close()


def _insist_on_an_answer(agent: str, answers: Answers[Forgotten]) -> None:
    for where, answer in answers.items():
        if isinstance(answer, LfieldError):
            raise CoordinatorAlive(
                f"--fresh is refused: {where} keeps {agent} for another mission, and has not given it up: "
                f"{answer}"
            )


def _in_the_way(away: Sequence[CopyPage]) -> str:
    page = away[0]
    return (
        f"--fresh is refused: {page.agent}, start {page.generation}, left for {page.target} (transfer "
        f"{page.sequence}) and may go on there; start {page.target} and try again, or end {page.agent} "
        "where it is"
    )


def _agreed(host: str, found: Anew, *, yes: bool) -> bool:
    """Name it and ask. Whoever cannot be asked has not agreed: raises UsageError."""
    print(f"--fresh throws away what {host} keeps of coordinators that could go on:")
    for page in found.thrown:
        where = f", parked at {found.parked[page]}" if page in found.parked else ""
        print(
            f"  {page.agent}, start {page.generation}, after {page.hops} hop{'s' * (page.hops != 1)}{where}"
        )
    if yes:
        return True
    if not sys.stdin.isatty():
        raise UsageError("nothing was thrown away: nobody can be asked here; add --yes if that is wanted")
    return says_yes("Type 'yes' to throw that away: ")

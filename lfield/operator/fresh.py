"""What a start from the beginning throws away of a journal, and what stands in its way. Pure.

`lfield up --fresh` begins another run. What this host itself holds it may throw away by a person's word; what
has left it belongs to somebody else, who is asked.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from msgspec import structs

from lfield.errors import LfieldError
from lfield.journal.pages import BundlePage, CopyPage, Page, Run
from lfield.operator.ask import Answers
from lfield.wire.coordinators import Outcome
from lfield.wire.observing import Status

#: The word of the person, as every host is told it.
WORD = "thrown away by 'lfield up --fresh'"


class Anew(NamedTuple):
    """The copies that are thrown away, those that may be alive elsewhere, and the pages that follow.

    `parked` says which host keeps one that is thrown away for another mission, and has to give it up.
    """

    thrown: Sequence[CopyPage]
    away: Sequence[CopyPage]
    pages: Sequence[Page]
    parked: Mapping[CopyPage, str]


def left(pages: Iterable[Page]) -> list[CopyPage]:
    """The copies that may have gone on elsewhere."""
    copies = (page for page in pages if isinstance(page, CopyPage))
    return [page for page in copies if page.state in ("PREPARED", "MOVED")]


def anew(host: str, pages: Sequence[Page], answers: Answers[Status]) -> Anew:
    """How the journal of a host is to be, so that its next start is a new run; the counter of starts stays.

    `answers` are those of the other hosts, as far as they were asked.
    """
    held = [page for page in pages if isinstance(page, CopyPage) and page.state == "RUN"]
    away, thrown, changed = list[CopyPage](), list(held), list[Page]()
    parked = dict[CopyPage, str]()
    for page in left(pages):
        ending, where = _told(page, answers), _parked(page, answers)
        if ending is not None:
            changed.append(ending)
        elif where:
            parked[page] = where
        else:
            away.append(page)
    thrown += parked
    changed += [_ended(page, "lost", WORD, host) for page in thrown]
    begun = [BundlePage(b"") for page in pages if isinstance(page, BundlePage)]
    return Anew(thrown, away, [*changed, Run(open=False), *begun], parked)


def _told(page: CopyPage, answers: Answers[Status]) -> CopyPage | None:
    """The ending of a copy that left, if any host knows of it."""
    for answer in answers.values():
        for known in () if isinstance(answer, LfieldError) else answer.coordinators:
            same = (known.agent, known.generation) == (page.agent, page.generation)
            if same and known.state == "EXITED":
                return _ended(page, known.outcome or "lost", known.detail, known.where)
    return None


def _parked(page: CopyPage, answers: Answers[Status]) -> str:
    """The host that keeps a copy that has left, for another mission; '' for none."""
    for where, answer in answers.items():
        journal = None if isinstance(answer, LfieldError) else answer.journal
        for parked in () if journal is None else journal.parked:
            same = (parked.agent, parked.generation) == (page.agent, page.generation)
            if same and parked.state == "RUN":
                return where
    return ""


def _ended(page: CopyPage, outcome: Outcome, detail: str, host: str) -> CopyPage:
    """The same start, ended. Told on by the host where it ended until all have confirmed."""
    return structs.replace(
        page, state="EXITED", outcome=outcome, detail=detail, ended_on=host, block=b"", program=b"", doubt=""
    )

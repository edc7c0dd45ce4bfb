"""Results of calls: a result on disk is kept until the record of its coordinator has it.

The results that a coordinator has not fetched are in the tickets of its newest block on any disk.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import lru_cache

from lfield.journal.records import CoordinatorRecord, PendingCallRecord, Record
from lfield.vm.memory.layout import (
    HEADER_WORDS,
    PROXY_MEMBER,
    TICKET,
    TICKET_GENERATION,
    TICKET_NUMBER,
    TICKET_PROXY,
    TICKET_STARTED,
    TICKET_STATE,
    W_TOP,
)
from simulation_testing.invariants.breaches import Breaches

#: The order of two records with one number.
_LATER = {"ABSENT": 0, "MOVED": 1, "PREPARED": 2, "RUN": 3, "EXITED": 4}

#: A result: the host, the identity of its journal, the coordinator, its start, the number of the call.
_Result = tuple[str, int, str, int, int]


class ResultChecks:
    """The results on all disks. `home` gives the host of a member of the team by its number."""

    def __init__(self, breaches: Breaches, home: Callable[[int], str]) -> None:
        self._breaches, self._home = breaches, home
        self._known: set[_Result] = set()

    def check(
        self,
        kept: Iterable[tuple[str, Record]],
        identities: Mapping[str, int],
        going: Collection[tuple[str, int]],
    ) -> None:
        """`kept` are the records of all hosts, `going` the starts whose results must not be deleted."""
        now: set[_Result] = set()
        newest: dict[tuple[str, int], CoordinatorRecord] = {}
        for name, page in kept:
            if isinstance(page, PendingCallRecord) and page.outcome:
                now.add((name, identities[name], page.agent, page.generation, page.number))
            elif isinstance(page, CoordinatorRecord) and (page.agent, page.generation) in going:
                start = page.agent, page.generation
                newest[start] = max(newest.get(start, page), page, key=_place)
        self._known |= now
        for page in newest.values():
            for generation, number, member in (
                pending_calls(page.block) if page.state in ("RUN", "PREPARED") else ()
            ):
                host = self._home(member)
                result = host, identities[host], page.agent, generation, number
                if generation == page.generation and result in self._known and result not in now:
                    found = (
                        f"{page.agent} still has to fetch call {number}, whose result was kept and is gone"
                    )
                    self._breaches.add("result", (host,), found)


def _place(page: CoordinatorRecord) -> tuple[int, int]:
    return page.sequence, _LATER[page.state]


@lru_cache(maxsize=512)
def pending_calls(block: bytes) -> tuple[tuple[int, int, int], ...]:
    """The calls that a block has begun and not fetched: the start, the number, the resource's number."""
    return tuple(_walk_pending_calls(memoryview(block).cast("q")) if block else ())


def _walk_pending_calls(w: memoryview[int]) -> Iterator[tuple[int, int, int]]:
    place = HEADER_WORDS
    while place < w[W_TOP]:
        if (
            w[place] & 0xFF == TICKET
            and w[place + TICKET_STATE] == TICKET_STARTED
            and w[place + TICKET_NUMBER]
        ):
            member = w[w[place + TICKET_PROXY] + PROXY_MEMBER]
            yield w[place + TICKET_GENERATION], w[place + TICKET_NUMBER], member
        place += w[place] >> 32

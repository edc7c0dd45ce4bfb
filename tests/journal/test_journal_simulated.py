"""The disk of a simulation is no kinder than a real one, when it breaks, is replaced, or its process dies."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest
from journal_bench import SimulatedBench

from lfield.clock import ManualClock
from lfield.errors import JournalError
from lfield.journal.pages import Key, Page, Run, Starts
from lfield.simulate.disk import RESERVE, JournalDisk

BEFORE: list[Page] = [Starts(1), Run(True)]
AFTER: list[Page] = [Starts(2), Run(False)]


@pytest.fixture
def bench() -> Iterator[SimulatedBench]:
    made = SimulatedBench()
    yield made
    made.end()


def test_a_commit_under_way_at_a_death_is_there_as_a_whole_or_not_at_all(bench: SimulatedBench) -> None:
    dice, found = random.Random(0), []
    for _ in range(40):
        bench.run(bench.open().keep(BEFORE))
        journal, told = bench.open(), list[None]()

        async def keep(journal=journal, told=told) -> None:  # type: ignore[no-untyped-def]
            await journal.keep(AFTER)
            told.append(None)

        bench.loop.enter(lambda keep=keep: bench.loop.create_task(keep()))  # type: ignore[misc]
        bench.timeline.run(dice.uniform(0.0, 1.2 * bench.disk.sync))
        left = bench.open().pages()
        assert left in (BEFORE, AFTER)
        assert left == AFTER or not told
        found.append((left == AFTER, bool(told)))
    # Not kept; kept and told to nobody; kept and told.
    assert set(found) == {(False, False), (True, False), (True, True)}


def test_a_broken_disk_refuses_and_may_have_kept_it_all_the_same(bench: SimulatedBench) -> None:
    found = []
    for _ in range(20):
        bench.run(bench.open().keep(BEFORE))
        journal = bench.open()
        bench.disk.broken = True
        with pytest.raises(JournalError, match="its disk fails"):
            bench.run(journal.keep(AFTER))
        assert journal.trouble == "its disk fails"
        with pytest.raises(JournalError):
            bench.open()
        bench.disk.broken = False
        found.append(bench.open().pages())
    assert [pages for pages in (BEFORE, AFTER) if pages not in found] == []


def test_a_full_disk_has_some_room_that_was_kept(bench: SimulatedBench) -> None:
    bench.disk.replace()
    journal = bench.open()
    bench.disk.full = True
    for count in range(RESERVE):
        bench.run(journal.keep([Starts(count)]))
        assert journal.trouble == "its disk is full"
    with pytest.raises(JournalError, match="no space is left"):
        bench.run(journal.keep([Starts(99)]))


def test_a_disk_that_was_replaced_is_empty_and_another_memory(bench: SimulatedBench) -> None:
    journal = bench.open()
    bench.run(journal.keep(BEFORE))
    bench.disk.replace()
    again = bench.open()
    assert again.pages() == []
    assert again.identity != journal.identity


def test_identities_come_from_the_dice() -> None:
    clock = ManualClock()
    drawn = [JournalDisk(random.Random(seed)).open(clock, print).identity for seed in (1, 1, 2)]
    assert drawn[0] == drawn[1] != drawn[2]


def test_only_what_is_on_it_can_be_damaged(bench: SimulatedBench) -> None:
    bench.run(bench.open().keep(BEFORE))
    bench.damage(Key("run"))
    assert bench.open().pages() == [Starts(1)]
    assert bench.told[0].startswith("whether the last run goes on, as of ")

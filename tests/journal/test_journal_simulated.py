"""The simulated disk keeps and loses records as a real one does: failure, replacement, killed process."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest
from journal_bench import SimulatedBench

from lfield.clock import ManualClock
from lfield.errors import JournalError
from lfield.journal.records import Record, RecordKey, RunMarker, StartCounter
from lfield.simulate.journal_disk import RESERVE, JournalDisk

BEFORE: list[Record] = [StartCounter(1), RunMarker(True)]
AFTER: list[Record] = [StartCounter(2), RunMarker(False)]


@pytest.fixture
def bench() -> Iterator[SimulatedBench]:
    simulated = SimulatedBench()
    yield simulated
    simulated.end()


def test_a_commit_during_a_kill_is_stored_completely_or_not_at_all(bench: SimulatedBench) -> None:
    rng, found = random.Random(0), []
    for _ in range(40):
        bench.run(bench.open().persist(BEFORE))
        journal, reported = bench.open(), list[None]()

        async def store(journal=journal, reported=reported) -> None:  # type: ignore[no-untyped-def]
            await journal.persist(AFTER)
            reported.append(None)

        bench.loop.enter(lambda store=store: bench.loop.create_task(store()))  # type: ignore[misc]
        bench.timeline.run(rng.uniform(0.0, 1.2 * bench.disk.sync))
        stored = bench.open().records()
        assert stored in (BEFORE, AFTER)
        assert stored == AFTER or not reported
        found.append((stored == AFTER, bool(reported)))
    # Not stored; stored and not reported; stored and reported.
    assert set(found) == {(False, False), (True, False), (True, True)}


def test_a_failed_write_may_still_have_stored_the_records(bench: SimulatedBench) -> None:
    found = []
    for _ in range(20):
        bench.run(bench.open().persist(BEFORE))
        journal = bench.open()
        bench.disk.broken = True
        with pytest.raises(JournalError, match="its disk fails"):
            bench.run(journal.persist(AFTER))
        assert journal.problem == "its disk fails"
        with pytest.raises(JournalError):
            bench.open()
        bench.disk.broken = False
        found.append(bench.open().records())
    assert [pages for pages in (BEFORE, AFTER) if pages not in found] == []


def test_a_full_disk_has_some_reserve(bench: SimulatedBench) -> None:
    bench.disk.replace()
    journal = bench.open()
    bench.disk.full = True
    for count in range(RESERVE):
        bench.run(journal.persist([StartCounter(count)]))
        assert journal.problem == "its disk is full"
    with pytest.raises(JournalError, match="no space is left"):
        bench.run(journal.persist([StartCounter(99)]))


def test_a_replaced_disk_is_empty_and_has_another_identity(bench: SimulatedBench) -> None:
    journal = bench.open()
    bench.run(journal.persist(BEFORE))
    bench.disk.replace()
    next_journal = bench.open()
    assert next_journal.records() == []
    assert next_journal.identity != journal.identity


def test_the_seed_determines_the_identity() -> None:
    clock = ManualClock()
    identities = [JournalDisk(random.Random(seed)).open(clock, print).identity for seed in (1, 1, 2)]
    assert identities[0] == identities[1] != identities[2]


def test_a_damaged_record_is_reported_and_the_others_are_kept(bench: SimulatedBench) -> None:
    bench.run(bench.open().persist(BEFORE))
    bench.damage(RecordKey("run"))
    assert bench.open().records() == [StartCounter(1)]
    assert bench.reports[0].startswith("whether the last run continues, stored ")

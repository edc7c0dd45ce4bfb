"""The promises of every journal, checked on a real disk and on a simulated one."""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from journal_bench import Bench, FileBench, SimulatedBench

from lfield.errors import JournalError
from lfield.journal.journal import Change, Journal
from lfield.journal.records import (
    BundleRecord,
    CoordinatorRecord,
    EmergencyStopFlag,
    FenceRecord,
    PauseFlag,
    PendingCallRecord,
    ProgramRecord,
    Record,
    RecordKey,
    ReservationRecord,
    RunMarker,
    StartCounter,
    key_of,
)

KINDS = ("file", "simulated")
#: One record of each kind.
PAGES: tuple[Record, ...] = (
    CoordinatorRecord("scout", 3, "RUN", sequence=7, hops=5, program=b"\1" * 32, block=bytes(5000)),
    PendingCallRecord("scout", 3, 8, "arm", "lift", "done", bytes(300), b"\1" * 32),
    StartCounter(3),
    RunMarker(True),
    BundleRecord(b"\2" * 32),
    PauseFlag(True),
    EmergencyStopFlag("the emergency stop was pressed: fog"),
    FenceRecord("scout", 2),
    ReservationRecord("arm", 41, "scout", 3),
    ProgramRecord(b"\1" * 32, bytes(100), ("scout", "arm"), ("Scout", "Arm"), ("barn", "field")),
)
#: Larger than the free space in the files of a new journal.
LARGE = CoordinatorRecord("scout", 4, "RUN", block=bytes(200_000))


@contextmanager
def bench_of(kind: str) -> Iterator[Bench]:
    with tempfile.TemporaryDirectory() as folder:
        bench = FileBench(Path(folder)) if kind == "file" else SimulatedBench()
        try:
            yield bench
        finally:
            bench.end()


@pytest.fixture(params=KINDS)
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    with bench_of(request.param) as selected:
        yield selected


def by_key(pages: Sequence[Record]) -> dict[RecordKey, Record]:
    found = {key_of(page): page for page in pages}
    assert len(found) == len(pages)
    return found


def test_stored_records_are_loaded_by_the_next_process(bench: Bench) -> None:
    journal = bench.open()
    assert journal.records() == []
    bench.run(journal.persist(PAGES))
    next_journal = bench.open()
    assert by_key(next_journal.records()) == by_key(PAGES)
    assert next_journal.identity == journal.identity
    assert bench.reports == []


def test_a_closed_journal_is_readable_and_accepts_no_records(bench: Bench) -> None:
    journal = bench.open()
    bench.run(journal.persist(PAGES))
    journal.close()
    with pytest.raises(JournalError, match="closed"):
        bench.run(journal.persist([StartCounter(9)]))
    assert by_key(bench.open().records()) == by_key(PAGES)


CHANGES = st.builds(
    Change,
    st.lists(
        st.builds(
            CoordinatorRecord, st.sampled_from("ab"), st.integers(0, 2), st.sampled_from(["RUN", "MOVED"])
        )
        | st.builds(StartCounter, st.integers(0, 2**63 - 1)),
        max_size=3,
    ),
    st.lists(st.builds(RecordKey, st.just("copy"), st.sampled_from("ab"), st.integers(0, 2)), max_size=2),
)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=12)
@given(changes=st.lists(CHANGES, max_size=6), waits=st.booleans())
def test_the_next_process_loads_the_result_of_any_changes(
    kind: str, changes: list[Change], waits: bool
) -> None:
    """`waits`: each change is awaited before the next; otherwise all are submitted at once, in order."""
    expected: dict[RecordKey, Record] = {}
    for pages, keys in changes:
        expected |= {key_of(page): page for page in pages}
        for key in keys:
            expected.pop(key, None)

    async def apply_changes(journal: Journal) -> None:
        calls = [call for pages, keys in changes for call in (journal.persist(pages), journal.delete(keys))]
        if not waits:
            await asyncio.gather(*calls)
            return
        for call in calls:
            await call

    with bench_of(kind) as bench:
        bench.run(apply_changes(bench.open()))
        assert by_key(bench.open().records()) == expected


def test_calls_of_one_turn_are_one_commit(bench: Bench) -> None:
    journal = bench.open()

    async def persist_counters() -> None:
        await asyncio.gather(*(journal.persist([StartCounter(count)]) for count in range(50)))

    bench.run(persist_counters())
    assert journal.commits_last_minute(bench.clock.monotonic()) == 1
    assert bench.open().records() == [StartCounter(49)]


def test_written_and_deleted_records_are_one_change(bench: Bench) -> None:
    journal = bench.open()
    bench.run(journal.persist(PAGES))
    new = CoordinatorRecord("scout", 3, "PREPARED", sequence=8, block=b"with all results")
    bench.run(journal.change([Change([new], [key_of(PAGES[1])])]))
    assert journal.commits_last_minute(bench.clock.monotonic()) == 2
    assert by_key(bench.open().records()) == by_key([new, *PAGES[2:]])


def test_a_record_has_the_time_of_its_storage(bench: Bench) -> None:
    before = bench.clock.time()
    journal = bench.open()
    assert not journal.times
    bench.run(journal.persist(PAGES))
    times = bench.open().times
    assert times.keys() == by_key(PAGES).keys()
    assert all(before <= stored <= bench.clock.time() for stored in times.values())


def test_a_full_disk_is_reported_and_the_journal_recovers(bench: Bench) -> None:
    journal = bench.open()
    bench.run(journal.persist([StartCounter(1)]))
    bench.fill(True)

    async def fail() -> None:
        with pytest.raises(JournalError, match="no space is left"):
            await journal.persist([StartCounter(2), LARGE])

    bench.run(fail())
    assert "no space" in journal.problem or "full" in journal.problem
    bench.fill(False)
    bench.run(journal.persist([]))
    assert journal.problem == ""
    # No record of the failed change is stored.
    assert bench.open().records() == [StartCounter(1)]


def test_calls_queued_behind_a_failed_commit_fail_too(bench: Bench) -> None:
    journal = bench.open()
    bench.fill(True)

    async def calls() -> list[BaseException | None]:
        first = asyncio.ensure_future(journal.persist([LARGE]))
        # The first commit starts; later calls wait for its end.
        for _ in range(2):
            await asyncio.sleep(0)
        later = asyncio.ensure_future(journal.persist([StartCounter(1)]))
        return await asyncio.gather(first, later, return_exceptions=True)

    assert [type(found) for found in bench.run(calls())] == [JournalError, JournalError]
    assert bench.open().records() == []


def test_a_damaged_record_is_reported_and_changes_the_identity(bench: Bench) -> None:
    journal = bench.open()
    bench.run(journal.persist(PAGES))
    journal.close()
    bench.damage(RecordKey("copy", "scout", 3))
    next_journal = bench.open()
    (report,) = bench.reports
    assert report.startswith("the copy of scout, start 3, stored ")
    assert "is damaged in the journal" in report
    assert by_key(next_journal.records()) == by_key(PAGES[1:])
    assert next_journal.identity != journal.identity
    third = bench.open()
    assert (third.identity, len(bench.reports)) == (next_journal.identity, 1)


def test_the_start_counter_is_lost_with_a_damaged_fence(bench: Bench) -> None:
    """The host then counts as a host that may have lost its promises."""
    journal = bench.open()
    bench.run(journal.persist(PAGES))
    journal.close()
    bench.damage(RecordKey("fence", "scout"))
    remaining = [page for page in PAGES if not isinstance(page, FenceRecord | StartCounter)]
    assert by_key(bench.open().records()) == by_key(remaining)
    (report,) = bench.reports
    assert report.startswith("the fence of scout, stored ")
    assert by_key(bench.open().records()) == by_key(remaining)


def test_an_unreadable_stop_is_reported_and_the_start_counter_is_kept(bench: Bench) -> None:
    journal = bench.open()
    bench.run(journal.persist([StartCounter(4), PauseFlag(True), EmergencyStopFlag("fog")]))
    journal.close()
    bench.damage(RecordKey("stopped"))
    assert by_key(bench.open().records()) == by_key([StartCounter(4), PauseFlag(True)])
    assert bench.reports[0].startswith("whether an emergency stop holds here, stored ")


def test_the_commits_of_a_minute_are_counted(bench: Bench) -> None:
    journal = bench.open()

    async def persist_three() -> None:
        for count in range(3):
            await journal.persist([StartCounter(count)])

    bench.run(persist_three())
    now = bench.clock.monotonic()
    assert journal.commits_last_minute(now) == 3
    assert journal.commits_last_minute(now + 60.0) == 0

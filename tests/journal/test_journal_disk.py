"""The journal on a disk that is slow, full or broken."""

from __future__ import annotations

import asyncio
import os
import sqlite3
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from journal_bench import OWNER, FileBench

from lfield.clock import ManualClock
from lfield.errors import JournalError
from lfield.journal.file_journal import FileJournal
from lfield.journal.records import CoordinatorRecord, StartCounter
from lfield.journal.space_reservation import MIN_BYTES, STEP_BYTES


def test_sqlite_forces_each_commit_to_the_disk(bench: FileBench) -> None:
    """The settings are checked, because a test cannot cut the power."""
    connection = bench.open()._store._connection
    assert connection.execute("PRAGMA synchronous").fetchone() == (2,)
    assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)


def test_a_slow_disk_does_not_block_the_loop_and_calls_are_joined_to_one_commit(bench: FileBench) -> None:
    journal = bench.open()
    store, started, done = journal._store, threading.Event(), threading.Event()
    write = store.commit

    def slow(groups: object) -> None:
        started.set()
        # If the event loop waited here, `done` would never be set.
        assert done.wait(60.0)
        write(groups)  # type: ignore[arg-type]

    store.commit = slow  # type: ignore[method-assign]

    async def calls() -> None:
        first = asyncio.ensure_future(journal.persist([StartCounter(0)]))
        while not started.is_set():
            await asyncio.sleep(0)
        more = [asyncio.ensure_future(journal.persist([StartCounter(count)])) for count in range(1, 100)]
        await asyncio.sleep(0)
        assert not first.done()
        done.set()
        await asyncio.gather(first, *more)

    bench.run(calls())
    assert journal.commits_last_minute(bench.clock.monotonic()) == 2
    assert bench.open().records() == [StartCounter(99)]


def failing(code: int, times: int, write: Callable[[object], None]) -> Callable[[object], None]:
    """A commit that SQLite refuses a few times."""
    left = [times]

    def commit(groups: object) -> None:
        if left[0]:
            left[0] -= 1
            error = sqlite3.OperationalError("refused")
            error.sqlite_errorcode = code
            raise error
        write(groups)

    return commit


def test_the_reserve_is_used_when_the_disk_is_full(bench: FileBench, monkeypatch: pytest.MonkeyPatch) -> None:
    journal = bench.open()
    reserve = bench.path.with_name("host.reserve")
    assert reserve.stat().st_size == MIN_BYTES
    bench.run(journal.persist([CoordinatorRecord("scout", 1, "RUN", block=bytes(3 * STEP_BYTES))]))
    assert reserve.stat().st_size == MIN_BYTES + 6 * STEP_BYTES
    assert reserve.stat().st_blocks * 512 >= MIN_BYTES + 6 * STEP_BYTES
    store = journal._store
    store.commit = failing(sqlite3.SQLITE_FULL, 1, store.commit)  # type: ignore
    with monkeypatch.context() as patch:
        patch.setattr(os, "posix_fallocate", failing_fallocate)
        bench.run(journal.persist([StartCounter(5)]))
        assert not reserve.exists()
        assert journal.problem == "its disk is full: it writes into the space that was kept in advance"
        # The log is overwritten; otherwise it would use the remaining space.
        for count in range(20):
            bench.run(
                journal.persist([CoordinatorRecord("scout", 1, "RUN", count, block=bytes(3 * STEP_BYTES))])
            )
        assert bench.path.with_name("host.journal-wal").stat().st_size < 9 * STEP_BYTES
    bench.run(journal.persist([]))
    assert reserve.exists()
    assert journal.problem == ""
    assert StartCounter(5) in bench.open().records()


def test_the_released_reserve_does_not_count_as_free_space(
    bench: FileBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = bench.open()
    statvfs, free = os.statvfs, [MIN_BYTES]

    def left(path: Path) -> object:
        found = statvfs(path)
        return SimpleNamespace(f_bavail=free[0] // 512, f_frsize=512, f_namemax=found.f_namemax)

    monkeypatch.setattr(os, "statvfs", left)
    store = journal._store
    store.commit = failing(sqlite3.SQLITE_FULL, 1, store.commit)  # type: ignore
    for count in range(3):
        bench.run(journal.persist([StartCounter(count)]))
        assert journal.problem == "its disk is full: it writes into the space that was kept in advance"
    free[0] = 2 * MIN_BYTES
    bench.run(journal.persist([]))
    assert journal.problem == ""
    assert bench.path.with_name("host.reserve").exists()


def test_a_disk_without_space_for_more_records_is_reported_once(
    bench: FileBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Coordinators arrive and leave, and nothing is released; departures make no space for arrivals."""
    journal = bench.open()
    reserve = bench.path.with_name("host.reserve")
    free = [0]
    monkeypatch.setattr(os, "statvfs", lambda path: SimpleNamespace(f_bavail=free[0] // 512, f_frsize=512))
    reports = []
    for hop in range(6):
        for state in ("RUN", "MOVED"):
            bench.run(
                journal.persist([CoordinatorRecord("scout", 1, state, hop, block=bytes(3 * STEP_BYTES))])
            )
            reports.append(journal.problem)
    assert set(reports) == {"its disk has room for what is here, and for no more"}
    assert reserve.stat().st_size == MIN_BYTES
    free[0] = 6 * STEP_BYTES - 512
    bench.run(journal.persist([]))
    assert journal.problem
    free[0] = 6 * STEP_BYTES
    for _ in range(2):
        bench.run(journal.persist([]))
        assert journal.problem == ""
    bench.run(journal.persist([CoordinatorRecord("scout", 1, "RUN", 9, block=bytes(3 * STEP_BYTES))]))
    assert (journal.problem, reserve.stat().st_size) == ("", MIN_BYTES + 6 * STEP_BYTES)


def test_a_reserve_that_cannot_grow_keeps_its_size(bench: FileBench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file system reported free space, and another process used it."""
    journal = bench.open()
    reserve = bench.path.with_name("host.reserve")
    monkeypatch.setattr(os, "posix_fallocate", failing_fallocate)
    bench.run(journal.persist([CoordinatorRecord("scout", 1, "RUN", block=bytes(STEP_BYTES))]))
    assert journal.problem == "its disk has room for what is here, and for no more"
    assert reserve.stat().st_size == MIN_BYTES
    monkeypatch.undo()
    bench.run(journal.persist([]))
    assert (journal.problem, reserve.stat().st_size) == ("", MIN_BYTES + 2 * STEP_BYTES)


def test_a_disk_that_is_full_from_the_beginning_has_no_reserve(
    bench: FileBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "statvfs", lambda path: SimpleNamespace(f_bavail=0, f_frsize=512, f_namemax=255))
    journal = bench.open()
    assert journal.problem == "its disk has room for what is here, and for no more"
    assert not bench.path.with_name("host.reserve").exists()


def failing_fallocate(descriptor: int, offset: int, size: int) -> None:
    raise OSError(28, "No space left on device")


def test_a_failing_disk_is_reported_and_retried(bench: FileBench) -> None:
    journal = bench.open()
    journal._store.commit = failing(sqlite3.SQLITE_IOERR, 2, journal._store.commit)  # type: ignore
    with pytest.raises(JournalError, match=r"its disk fails; see the kernel log \(dmesg\)") as found:
        bench.run(journal.persist([StartCounter(1)]))
    assert (found.value.exit_status, journal.problem) == (73, "its disk fails")
    bench.run(journal.persist([StartCounter(2)]))
    assert journal.problem == ""
    assert bench.open().records() == [StartCounter(2)]


def test_a_journal_removed_while_in_use_accepts_no_records(bench: FileBench) -> None:
    journal = bench.open()
    bench.run(journal.persist([StartCounter(1)]))
    bench.path.rename(bench.path.with_name("elsewhere"))
    with pytest.raises(JournalError, match="no such file"):
        bench.run(journal.persist([StartCounter(2)]))
    bench.path.write_bytes(b"")
    with pytest.raises(JournalError, match="another file was put in its place"):
        bench.run(journal.persist([StartCounter(2)]))


def test_a_folder_that_cannot_be_made_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(JournalError, match="it is not a folder") as found:
        FileJournal(tmp_path / "file" / "host.journal", OWNER, print, ManualClock())
    assert found.value.exit_status == 73

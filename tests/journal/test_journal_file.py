"""The journal on a real disk: its owner, a slow disk, a full one, a damaged file, a killed process."""

from __future__ import annotations

import asyncio
import os
import random
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from journal_bench import OWNER, FileBench

from lfield.clock import ManualClock
from lfield.errors import ForeignJournal, InputFileError, JournalError, JournalInUse
from lfield.journal.file_journal import FileJournal
from lfield.journal.journal import journal_file
from lfield.journal.journal_lock import machine_id
from lfield.journal.readonly_view import open_read_only
from lfield.journal.records import CoordinatorRecord, Record, RunMarker, StartCounter
from lfield.journal.space_reservation import MIN_BYTES, STEP_BYTES

PAGES: list[Record] = [CoordinatorRecord(f"agent{n}", 1, "RUN", block=bytes([n]) * 3000) for n in range(20)]


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[FileBench]:
    made = FileBench(tmp_path)
    yield made
    made.end()


def filled(bench: FileBench) -> bytes:
    """The bytes of a journal with PAGES, of a process that ended regularly."""
    journal = bench.open()
    bench.run(journal.persist(PAGES))
    journal.close()
    return bench.path.read_bytes()


# --- its owner ----------------------------------------------------------------------------------------


def test_the_file_is_named_after_deployment_and_host(tmp_path: Path) -> None:
    path = journal_file(tmp_path, "a/b?c#", "h@1")
    assert path == tmp_path / "a%2Fb%3Fc%23@h%401" / "host.journal"
    # SQLite opens it by an address in which all of these characters have a meaning.
    FileJournal(path, OWNER, print, ManualClock()).close()
    assert path.exists()


def test_a_second_process_is_refused_with_the_number_of_the_first(bench: FileBench) -> None:
    journal = bench.open()
    with pytest.raises(JournalInUse, match=f"process {os.getpid()} has it open; stop that process") as found:
        FileJournal(bench.path, OWNER, print, bench.clock)
    assert (found.value.process, found.value.exit_status) == (os.getpid(), 69)
    journal.close()
    FileJournal(bench.path, OWNER, print, bench.clock).close()


@pytest.mark.parametrize(
    ("owner", "says"),
    [
        (OWNER._replace(deployment="sowing"), "it is that of barn in harvest, and this is barn in sowing"),
        (OWNER._replace(host="field"), "it is that of barn in harvest, and this is field in harvest"),
        (OWNER._replace(machine="another"), "it was written on another computer"),
    ],
)
def test_a_foreign_journal_is_refused_and_not_changed(bench: FileBench, owner: object, says: str) -> None:
    data = filled(bench)
    with pytest.raises(ForeignJournal, match=says) as found:
        FileJournal(bench.path, owner, print, bench.clock)  # type: ignore[arg-type]
    assert found.value.exit_status == 65
    assert bench.path.read_bytes() == data


@pytest.mark.parametrize("statement", ["PRAGMA user_version = 2", None])
def test_a_newer_version_is_refused_and_not_changed(
    bench: FileBench, statement: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    filled(bench)
    if statement is not None:
        bench.sql(statement)
    else:
        journal = bench.open()
        monkeypatch.setattr("lfield.journal.records.VERSION", 3)
        bench.run(journal.persist([StartCounter(1)]))
        journal.close()
        monkeypatch.undo()
    data = bench.path.read_bytes()
    with pytest.raises(ForeignJournal, match="install the version of lfield that wrote it"):
        bench.open()
    if statement is not None:
        with pytest.raises(ForeignJournal):
            open_read_only(bench.path)
    else:
        # A read-only process sees all other records.
        seen = open_read_only(bench.path)
        assert len(seen.records) == len(PAGES)
        assert [one.why for one in seen.damaged] == ["it is of version 3: install the lfield that wrote it"]
    assert bench.path.read_bytes() == data


def test_a_pipe_in_place_of_a_journal_does_not_block(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "host.journal")
    with pytest.raises(InputFileError, match="not a file"):
        open_read_only(tmp_path / "host.journal")


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (Path.mkdir, "it is a folder"),
        (os.mkfifo, "not a file"),
        (lambda path: path.symlink_to("elsewhere/host.journal"), "it is a link that leads nowhere"),
        (lambda path: path.symlink_to(path), "it is a link that leads nowhere"),
    ],
)
def test_a_path_that_is_no_journal_is_refused_and_not_replaced(
    tmp_path: Path, made: Callable[[Path], None], says: str
) -> None:
    path = tmp_path / "host.journal"
    made(path)
    before = path.lstat().st_ino
    with pytest.raises(JournalError) as found:
        FileJournal(path, OWNER, print, ManualClock())
    assert (found.value.exit_status, path.lstat().st_ino) == (73, before)
    assert str(found.value) == (
        f"cannot use the journal {path}: {says}; "
        "put the journal back, or remove it: this host then starts with an empty one"
    )
    with pytest.raises(InputFileError, match=says):
        open_read_only(path)


def test_a_journal_may_be_behind_a_symbolic_link(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    first = FileJournal(tmp_path / "disk" / "host.journal", OWNER, print, ManualClock())
    first.close()
    path = tmp_path / "host.journal"
    path.symlink_to("disk/host.journal")
    second = FileJournal(path, OWNER, print, ManualClock())
    assert second.identity == first.identity
    second.close()


def test_a_board_is_distinguished_from_its_copy_by_its_serial_number(tmp_path: Path) -> None:
    assert machine_id(tmp_path) == ""
    (tmp_path / "etc").mkdir()
    (tmp_path / "etc/machine-id").write_text("uninitialized\n")
    assert machine_id(tmp_path) == ""
    (tmp_path / "etc/machine-id").write_text("3d1219c7c4c5404aaa1f6d2a48adfda4\n")
    copied = machine_id(tmp_path)
    assert len(copied) == 32
    assert "3d1219c7" not in copied
    (tmp_path / "proc/device-tree").mkdir(parents=True)
    (tmp_path / "proc/device-tree/serial-number").write_bytes(b"0000000000000000\0")
    assert machine_id(tmp_path) == copied
    (tmp_path / "proc/device-tree/serial-number").write_bytes(b"10000000a3b1c2d3\0")
    assert machine_id(tmp_path) not in ("", copied)


def test_other_users_may_not_read_the_journal(bench: FileBench) -> None:
    bench.run(bench.open().persist([StartCounter(1)]))
    assert {path.stat().st_mode & 0o077 for path in bench.path.parent.iterdir()} == {0}


# --- its disk -----------------------------------------------------------------------------------------


def test_sqlite_forces_each_commit_to_the_disk(bench: FileBench) -> None:
    """A test cannot cut the power."""
    connection = bench.open()._store._connection
    assert connection.execute("PRAGMA synchronous").fetchone() == (2,)
    assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)


def test_a_slow_disk_does_not_block_the_loop_and_calls_are_joined_to_one_commit(bench: FileBench) -> None:
    journal = bench.open()
    store, started, done = journal._store, threading.Event(), threading.Event()
    write = store.commit

    def slow(groups: object) -> None:
        started.set()
        # A wait for this on the loop would never end.
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
        assert journal.trouble == "its disk is full: it writes into the space that was kept in advance"
        # The log is overwritten; otherwise it would use the remaining space.
        for count in range(20):
            bench.run(
                journal.persist([CoordinatorRecord("scout", 1, "RUN", count, block=bytes(3 * STEP_BYTES))])
            )
        assert bench.path.with_name("host.journal-wal").stat().st_size < 9 * STEP_BYTES
    bench.run(journal.persist([]))
    assert reserve.exists()
    assert journal.trouble == ""
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
        assert journal.trouble == "its disk is full: it writes into the space that was kept in advance"
    free[0] = 2 * MIN_BYTES
    bench.run(journal.persist([]))
    assert journal.trouble == ""
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
            reports.append(journal.trouble)
    assert set(reports) == {"its disk has room for what is here, and for no more"}
    assert reserve.stat().st_size == MIN_BYTES
    free[0] = 6 * STEP_BYTES - 512
    bench.run(journal.persist([]))
    assert journal.trouble
    free[0] = 6 * STEP_BYTES
    for _ in range(2):
        bench.run(journal.persist([]))
        assert journal.trouble == ""
    bench.run(journal.persist([CoordinatorRecord("scout", 1, "RUN", 9, block=bytes(3 * STEP_BYTES))]))
    assert (journal.trouble, reserve.stat().st_size) == ("", MIN_BYTES + 6 * STEP_BYTES)


def test_a_reserve_that_cannot_grow_keeps_its_size(bench: FileBench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file system reported free space, and another process used it."""
    journal = bench.open()
    reserve = bench.path.with_name("host.reserve")
    monkeypatch.setattr(os, "posix_fallocate", failing_fallocate)
    bench.run(journal.persist([CoordinatorRecord("scout", 1, "RUN", block=bytes(STEP_BYTES))]))
    assert journal.trouble == "its disk has room for what is here, and for no more"
    assert reserve.stat().st_size == MIN_BYTES
    monkeypatch.undo()
    bench.run(journal.persist([]))
    assert (journal.trouble, reserve.stat().st_size) == ("", MIN_BYTES + 2 * STEP_BYTES)


def test_a_disk_that_is_full_from_the_beginning_has_no_reserve(
    bench: FileBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "statvfs", lambda path: SimpleNamespace(f_bavail=0, f_frsize=512, f_namemax=255))
    journal = bench.open()
    assert journal.trouble == "its disk has room for what is here, and for no more"
    assert not bench.path.with_name("host.reserve").exists()


def failing_fallocate(descriptor: int, offset: int, size: int) -> None:
    raise OSError(28, "No space left on device")


def test_a_failing_disk_is_reported_and_retried(bench: FileBench) -> None:
    journal = bench.open()
    journal._store.commit = failing(sqlite3.SQLITE_IOERR, 2, journal._store.commit)  # type: ignore
    with pytest.raises(JournalError, match=r"its disk fails; see the kernel log \(dmesg\)") as found:
        bench.run(journal.persist([StartCounter(1)]))
    assert (found.value.exit_status, journal.trouble) == (73, "its disk fails")
    bench.run(journal.persist([StartCounter(2)]))
    assert journal.trouble == ""
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


# --- damage -------------------------------------------------------------------------------------------


def test_no_record_is_lost_without_a_report_for_any_damage(bench: FileBench) -> None:
    data, dice = filled(bench), random.Random(0)
    identity = bench.open().identity
    bench.end()
    for _ in range(40):
        wrong = bytearray(data)
        if dice.random() < 0.5:
            at = 4096 * dice.randrange(len(data) // 4096)
            wrong[at : at + 4096] = dice.randbytes(4096)
        else:
            wrong[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
        bench.path.write_bytes(wrong)
        bench.reports.clear()
        journal = FileJournal(bench.path, OWNER, bench.reports.append, bench.clock)
        journal.close()
        assert all(page in PAGES for page in journal.records())
        if len(journal.records()) < len(PAGES):
            assert bench.reports
            assert journal.identity != identity


@pytest.mark.parametrize(
    ("wrong", "left"),
    [
        (lambda data: b"", 0),
        (lambda data: b"no database at all", 0),
        (lambda data: data[: len(data) // 2], 5),
        (lambda data: data[: 12 * 4096] + bytes(4096) + data[13 * 4096 :], 15),
        (lambda data: data.replace(b"CREATE TABLE damaged", b"CREATE \x87ABLE damaged"), 20),
        (lambda data: bytes(4096) + data[4096:], 20),
        (lambda data: b"SQLite format 3\0" + bytes(data)[16:100] + bytes(3996) + data[4096:], 20),
    ],
    ids=["empty", "other", "truncated", "hole", "no schema", "no first page", "no tables"],
)
def test_a_damaged_file_is_moved_aside_and_readable_records_are_kept(
    bench: FileBench, wrong: Callable[[bytes], bytes], left: int
) -> None:
    data = wrong(filled(bench))
    bench.path.write_bytes(data)
    if left:
        assert len(open_read_only(bench.path).records) >= left
    journal = bench.open()
    assert len(journal.records()) >= left
    assert "is damaged" in bench.reports[0]
    assert "is now host.journal.damaged-1" in bench.reports[0]
    assert bench.path.with_name("host.journal.damaged-1").read_bytes()[:50] == data[:50]
    reports = len(bench.reports)
    bench.open()
    assert len(bench.reports) == reports


def test_an_interrupted_replacement_of_the_file_is_completed_by_the_next_process(
    bench: FileBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = filled(bench)[:50_000]
    rename, left = Path.rename, [0]

    def killed(path: Path, target: Path) -> Path:
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        return rename(path, target)

    for renames in range(4):
        left[0] = renames
        for old in bench.path.parent.iterdir():
            old.unlink()
        bench.path.write_bytes(data)
        with monkeypatch.context() as patch:
            patch.setattr(Path, "rename", killed)
            with pytest.raises(KeyboardInterrupt):
                FileJournal(bench.path, OWNER, bench.reports.append, bench.clock)
        journal = FileJournal(bench.path, OWNER, bench.reports.append, bench.clock)
        journal.close()
        assert len(journal.records()) >= 5
        assert bench.path.with_name("host.journal.damaged-1").read_bytes()[:50_000] == data


def test_a_damaged_record_is_kept_for_inspection(bench: FileBench) -> None:
    filled(bench)
    bench.sql("UPDATE pages SET body = x'00' WHERE name = 'agent3'")
    assert [one.entry.key.name for one in open_read_only(bench.path).damaged] == ["agent3"]
    bench.open()
    seen = open_read_only(bench.path)
    assert (len(seen.records), seen.damaged) == (19, [])
    assert [(one.entry.key.name, one.why) for one in seen.moved_aside] == [
        ("agent3", "its checksum does not fit")
    ]


# --- a killed process ---------------------------------------------------------------------------------


@pytest.mark.process
def test_a_killed_process_has_stored_all_reported_records_and_no_partial_one(bench: FileBench) -> None:
    writer = [sys.executable, str(Path(__file__).with_name("journal_writer.py")), str(bench.path.parent)]
    for _ in range(2):
        with subprocess.Popen(writer, stdout=subprocess.PIPE, text=True) as child:
            assert child.stdout is not None
            for _ in range(30):
                said = int(child.stdout.readline())
            child.kill()
            said = int((child.stdout.read().split() or [said])[-1])
    journal = FileJournal(bench.path, OWNER, bench.reports.append, bench.clock)
    journal.close()
    starts, copy = journal.records()
    assert isinstance(starts, StartCounter)
    assert isinstance(copy, CoordinatorRecord)
    assert starts.count in (said, said + 1)
    assert copy.sequence == starts.count
    assert copy.block == starts.count.to_bytes(8, "big") * 1000
    assert bench.reports == []
    assert RunMarker(True) not in journal.records()

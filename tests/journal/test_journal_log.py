"""The write-ahead log of a journal: commits cut off by a power failure, and damaged frames."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from journal_bench import OWNER, FileBench

from lfield.errors import JournalInUse
from lfield.journal.file_journal import FileJournal
from lfield.journal.readonly_view import open_read_only
from lfield.journal.records import CoordinatorRecord, StartCounter
from lfield.journal.wal import read_wal, wal_file

#: Sizes in a log: the header of the file, the header of a frame, and a whole frame.
HEAD, FRAME, WHOLE = 32, 24, 24 + 4096


def journal_of_killed_process(bench: FileBench, place: Path, counts: int = 30) -> Path:
    """The journal of a process that was killed after `counts` records."""
    journal = bench.open()
    bench.run(journal.persist([CoordinatorRecord("pilot", 1, "RUN", block=bytes(9000))]))
    for count in range(1, counts + 1):
        bench.run(journal.persist([StartCounter(count)]))
    shutil.copytree(bench.path.parent, place)
    return place / bench.path.name


def flip_bit(path: Path, at: int) -> None:
    """Flip a bit of a journal's log."""
    data = bytearray(wal_file(path).read_bytes())
    data[at] ^= 1
    wal_file(path).write_bytes(data)


def reopened(bench: FileBench, path: Path) -> FileJournal:
    """The journal as the next process opens and closes it."""
    journal = FileJournal(path, OWNER, bench.reports.append, bench.clock)
    journal.close()
    return journal


def count_of(journal: FileJournal) -> int | None:
    return next((page.count for page in journal.records() if isinstance(page, StartCounter)), None)


def test_a_complete_log_is_read_as_by_sqlite(bench: FileBench, tmp_path: Path) -> None:
    log = read_wal(journal_of_killed_process(bench, tmp_path / "copy"))
    assert (log.valid_prefix, log.fault) == (len(log.frames), "")
    assert log.valid_prefix > 30


def test_a_wrong_bit_in_an_older_commit_loses_no_later_record(bench: FileBench, tmp_path: Path) -> None:
    path = journal_of_killed_process(bench, tmp_path / "copy")
    flip_bit(path, HEAD + 20 * WHOLE + FRAME + 2000)
    assert read_wal(path).fault.startswith("frame 21 of the ")
    assert "of its log is damaged" in open_read_only(path).fault
    journal = reopened(bench, path)
    assert count_of(journal) == 30
    assert bench.journal is not None
    assert journal.identity == bench.journal.identity
    assert "frame 21 of the " in bench.reports[0]
    assert bench.reports[0].endswith("nothing is lost")
    reopened(bench, path)
    assert len(bench.reports) == 1


def test_no_older_record_is_used_when_the_newest_is_damaged(bench: FileBench, tmp_path: Path) -> None:
    path = journal_of_killed_process(bench, tmp_path / "copy")
    log = read_wal(path)
    # The block of the copy was written once: no later frame replaces its pages.
    last = {frame.number: at for at, frame in enumerate(log.frames)}
    flip_bit(path, HEAD + min(last.values()) * WHOLE + FRAME + 2000)
    assert {record.entry.key.kind for record in open_read_only(path).damaged} >= {"starts"}
    journal = reopened(bench, path)
    assert journal.records() == []
    assert bench.journal is not None
    assert journal.identity != bench.journal.identity
    assert "stay in doubt" in bench.reports[0]
    assert any("a later one may have been lost with the log" in line for line in bench.reports)
    assert reopened(bench, path).identity == journal.identity


@pytest.mark.parametrize("at", [8, 20], ids=["salt", "checksum"])
def test_a_damaged_header_of_an_older_frame_is_detected(bench: FileBench, tmp_path: Path, at: int) -> None:
    path = journal_of_killed_process(bench, tmp_path / "copy")
    flip_bit(path, HEAD + 20 * WHOLE + at)
    assert read_wal(path).valid_prefix == 20
    assert count_of(reopened(bench, path)) in (30, None)
    assert bench.reports


def test_a_log_with_a_damaged_header_is_still_read(bench: FileBench, tmp_path: Path) -> None:
    path = journal_of_killed_process(bench, tmp_path / "copy")
    flip_bit(path, 17)
    assert count_of(reopened(bench, path)) in (30, None)
    assert "frame 1 of the " in bench.reports[0]


def test_an_incomplete_last_commit_counts_as_a_power_cut(bench: FileBench, tmp_path: Path) -> None:
    path = journal_of_killed_process(bench, tmp_path / "copy")
    frames = read_wal(path).frames
    for cut in (1, WHOLE // 2, WHOLE - 1):
        shutil.copytree(path.parent, place := tmp_path / f"cut{cut}")
        data = wal_file(path).read_bytes()
        wal_file(place / path.name).write_bytes(data[: HEAD + len(frames) * WHOLE - cut])
        assert count_of(reopened(bench, place / path.name)) == 29
    flip_bit(path, HEAD + (len(frames) - 1) * WHOLE + FRAME)
    assert read_wal(path).fault == ""
    assert count_of(reopened(bench, path)) == 29
    assert bench.reports == []


def test_frames_left_by_an_earlier_log_are_not_damage(bench: FileBench, tmp_path: Path) -> None:
    journal = bench.open()
    bench.run(journal.persist([CoordinatorRecord("pilot", 1, "RUN", block=bytes(90_000))]))
    journal._restart_log()
    bench.run(journal.persist([StartCounter(1)]))
    log = read_wal(bench.path)
    assert wal_file(bench.path).stat().st_size > HEAD + (len(log.frames) + 10) * WHOLE
    assert log.fault == ""


def test_a_missing_log_is_reported_and_older_records_are_not_used(bench: FileBench, tmp_path: Path) -> None:
    for damage in (Path.unlink, lambda log: log.write_bytes(b"")):
        path = journal_of_killed_process(bench, tmp_path / f"copy{bool(bench.reports)}")
        bench.reports.clear()
        damage(wal_file(path))
        assert open_read_only(path).fault == "its log is missing"
        journal = reopened(bench, path)
        assert journal.records() == []
        assert "its log is missing" in bench.reports[0]
        assert bench.journal is not None
        assert journal.identity != bench.journal.identity
        count = len(bench.reports)
        reopened(bench, path)
        assert len(bench.reports) == count


def test_a_log_removed_while_in_use_loses_nothing(bench: FileBench) -> None:
    journal = bench.open()
    bench.run(journal.persist([StartCounter(1)]))
    wal_file(bench.path).unlink()
    bench.run(journal.persist([CoordinatorRecord("pilot", 1, "RUN")]))
    assert wal_file(bench.path).exists()
    bench.run(journal.persist([CoordinatorRecord("pilot", 2, "RUN")]))
    assert len(bench.open().records()) == 3
    assert bench.reports == []


def test_a_regular_end_leaves_no_log(bench: FileBench) -> None:
    for count in (1, 2):
        journal = bench.open()
        bench.run(journal.persist([StartCounter(count)]))
        journal.close()
        bench.journal = None
        assert not wal_file(bench.path).exists()
    assert count_of(bench.open()) == 2
    assert bench.reports == []


def test_the_lock_remains_when_its_file_is_removed(bench: FileBench) -> None:
    bench.open()
    bench.path.with_name("host.lock").unlink()
    with pytest.raises(JournalInUse, match="another process has it open"):
        FileJournal(bench.path, OWNER, print, bench.clock)

"""The write-ahead log of a journal: what of it a power cut may take, and what is damage."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from journal_bench import OWNER, FileBench

from lfield.errors import JournalInUse
from lfield.journal.file_journal import FileJournal
from lfield.journal.readonly_view import open_read_only
from lfield.journal.records import CoordinatorRecord, StartCounter
from lfield.journal.wal import read_wal, wal_file

#: In a log: what stands before the frames, before an image, and one frame as a whole.
HEAD, FRAME, WHOLE = 32, 24, 24 + 4096


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[FileBench]:
    made = FileBench(tmp_path)
    yield made
    made.end()


def killed(bench: FileBench, place: Path, counts: int = 30) -> Path:
    """The journal of a process that was killed when it had counted so far; the last word was `counts`."""
    journal = bench.open()
    bench.run(journal.persist([CoordinatorRecord("pilot", 1, "RUN", block=bytes(9000))]))
    for count in range(1, counts + 1):
        bench.run(journal.persist([StartCounter(count)]))
    shutil.copytree(bench.path.parent, place)
    return place / bench.path.name


def spoil(path: Path, at: int) -> None:
    """Flip a bit of a journal's log."""
    data = bytearray(wal_file(path).read_bytes())
    data[at] ^= 1
    wal_file(path).write_bytes(data)


def again(bench: FileBench, path: Path) -> FileJournal:
    """The next process."""
    journal = FileJournal(path, OWNER, bench.told.append, bench.clock)
    journal.close()
    return journal


def count_of(journal: FileJournal) -> int | None:
    return next((page.count for page in journal.records() if isinstance(page, StartCounter)), None)


def test_a_log_that_is_whole_is_as_sqlite_reads_it(bench: FileBench, tmp_path: Path) -> None:
    log = read_wal(killed(bench, tmp_path / "left"))
    assert (log.valid_prefix, log.fault) == (len(log.frames), "")
    assert log.valid_prefix > 30


def test_a_wrong_bit_in_an_older_commit_takes_nothing_of_what_came_later(
    bench: FileBench, tmp_path: Path
) -> None:
    path = killed(bench, tmp_path / "left")
    spoil(path, HEAD + 20 * WHOLE + FRAME + 2000)
    assert read_wal(path).fault.startswith("frame 21 of the ")
    assert "of its log is damaged" in open_read_only(path).fault
    journal = again(bench, path)
    assert count_of(journal) == 30
    assert bench.journal is not None
    assert journal.identity == bench.journal.identity
    assert "frame 21 of the " in bench.told[0]
    assert bench.told[0].endswith("nothing is lost")
    again(bench, path)
    assert len(bench.told) == 1


def test_where_the_newest_page_is_damaged_no_older_one_goes_on(bench: FileBench, tmp_path: Path) -> None:
    path = killed(bench, tmp_path / "left")
    log = read_wal(path)
    # The frames of the copy's block are the newest of their pages: nothing replaces them.
    last = {frame.number: at for at, frame in enumerate(log.frames)}
    spoil(path, HEAD + min(last.values()) * WHOLE + FRAME + 2000)
    assert {one.entry.key.kind for one in open_read_only(path).damaged} >= {"starts"}
    journal = again(bench, path)
    assert journal.records() == []
    assert bench.journal is not None
    assert journal.identity != bench.journal.identity
    assert "stay in doubt" in bench.told[0]
    assert any("a later one may have been lost with the log" in line for line in bench.told)
    assert again(bench, path).identity == journal.identity


@pytest.mark.parametrize("at", [8, 20], ids=["which log", "checksum"])
def test_every_older_frame_may_be_damaged_in_its_header(bench: FileBench, tmp_path: Path, at: int) -> None:
    path = killed(bench, tmp_path / "left")
    spoil(path, HEAD + 20 * WHOLE + at)
    assert read_wal(path).valid_prefix == 20
    assert count_of(again(bench, path)) in (30, None)
    assert bench.told


def test_a_log_whose_beginning_is_damaged_is_read_all_the_same(bench: FileBench, tmp_path: Path) -> None:
    path = killed(bench, tmp_path / "left")
    spoil(path, 17)
    assert count_of(again(bench, path)) in (30, None)
    assert "frame 1 of the " in bench.told[0]


def test_a_last_commit_that_is_not_whole_is_what_a_power_cut_leaves(bench: FileBench, tmp_path: Path) -> None:
    path = killed(bench, tmp_path / "left")
    frames = read_wal(path).frames
    for cut in (1, WHOLE // 2, WHOLE - 1):
        shutil.copytree(path.parent, place := tmp_path / f"cut{cut}")
        data = wal_file(path).read_bytes()
        wal_file(place / path.name).write_bytes(data[: HEAD + len(frames) * WHOLE - cut])
        assert count_of(again(bench, place / path.name)) == 29
    spoil(path, HEAD + (len(frames) - 1) * WHOLE + FRAME)
    assert read_wal(path).fault == ""
    assert count_of(again(bench, path)) == 29
    assert bench.told == []


def test_what_is_left_of_an_earlier_log_behind_this_one_is_no_damage(
    bench: FileBench, tmp_path: Path
) -> None:
    journal = bench.open()
    bench.run(journal.persist([CoordinatorRecord("pilot", 1, "RUN", block=bytes(90_000))]))
    journal._restart_log()
    bench.run(journal.persist([StartCounter(1)]))
    log = read_wal(bench.path)
    assert wal_file(bench.path).stat().st_size > HEAD + (len(log.frames) + 10) * WHOLE
    assert log.fault == ""


def test_a_log_that_is_missing_is_told_and_what_is_older_does_not_go_on(
    bench: FileBench, tmp_path: Path
) -> None:
    for spoilt in (Path.unlink, lambda log: log.write_bytes(b"")):
        path = killed(bench, tmp_path / f"left{bool(bench.told)}")
        bench.told.clear()
        spoilt(wal_file(path))
        assert open_read_only(path).fault == "its log is missing"
        journal = again(bench, path)
        assert journal.records() == []
        assert "its log is missing" in bench.told[0]
        assert bench.journal is not None
        assert journal.identity != bench.journal.identity
        told = len(bench.told)
        again(bench, path)
        assert len(bench.told) == told


def test_a_log_that_is_removed_while_it_is_in_use_loses_nothing(bench: FileBench) -> None:
    journal = bench.open()
    bench.run(journal.persist([StartCounter(1)]))
    wal_file(bench.path).unlink()
    bench.run(journal.persist([CoordinatorRecord("pilot", 1, "RUN")]))
    assert wal_file(bench.path).exists()
    bench.run(journal.persist([CoordinatorRecord("pilot", 2, "RUN")]))
    assert len(bench.open().records()) == 3
    assert bench.told == []


def test_an_orderly_end_leaves_no_log_to_be_missed(bench: FileBench) -> None:
    for count in (1, 2):
        journal = bench.open()
        bench.run(journal.persist([StartCounter(count)]))
        journal.close()
        bench.journal = None
        assert not wal_file(bench.path).exists()
    assert count_of(bench.open()) == 2
    assert bench.told == []


def test_the_lock_stays_when_its_file_is_removed(bench: FileBench) -> None:
    bench.open()
    bench.path.with_name("host.lock").unlink()
    with pytest.raises(JournalInUse, match="another process has it open"):
        FileJournal(bench.path, OWNER, print, bench.clock)

"""The journal on a real disk: its owner, damage to its file, and a killed process."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from journal_bench import OWNER, FileBench

from lfield.clock import ManualClock
from lfield.errors import ForeignJournal, InputFileError, JournalError, JournalInUse
from lfield.journal.file_journal import FileJournal
from lfield.journal.journal import journal_file
from lfield.journal.journal_lock import machine_id
from lfield.journal.readonly_view import open_read_only
from lfield.journal.records import CoordinatorRecord, Record, RunMarker, StartCounter

PAGES: list[Record] = [CoordinatorRecord(f"agent{n}", 1, "RUN", block=bytes([n]) * 3000) for n in range(20)]


def filled(bench: FileBench) -> bytes:
    """The file contents of a journal with PAGES, after a regular end of its process."""
    journal = bench.open()
    bench.run(journal.persist(PAGES))
    journal.close()
    return bench.path.read_bytes()


# --- its owner ----------------------------------------------------------------------------------------


def test_the_file_is_named_after_deployment_and_host(tmp_path: Path) -> None:
    path = journal_file(tmp_path, "a/b?c#", "h@1")
    assert path == tmp_path / "a%2Fb%3Fc%23@h%401" / "host.journal"
    # SQLite opens the file by a URI, in which these characters are special.
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
    ("owner", "reason"),
    [
        (OWNER._replace(deployment="sowing"), "it is that of barn in harvest, and this is barn in sowing"),
        (OWNER._replace(host="field"), "it is that of barn in harvest, and this is field in harvest"),
        (OWNER._replace(machine="another"), "it was written on another computer"),
    ],
)
def test_a_foreign_journal_is_refused_and_not_changed(bench: FileBench, owner: object, reason: str) -> None:
    data = filled(bench)
    with pytest.raises(ForeignJournal, match=reason) as found:
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
        observed = open_read_only(bench.path)
        assert len(observed.records) == len(PAGES)
        assert [record.reason for record in observed.damaged] == [
            "it is of version 3: install the lfield that wrote it"
        ]
    assert bench.path.read_bytes() == data


def test_a_pipe_in_place_of_a_journal_does_not_block(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "host.journal")
    with pytest.raises(InputFileError, match="not a file"):
        open_read_only(tmp_path / "host.journal")


@pytest.mark.parametrize(
    ("create", "reason"),
    [
        (Path.mkdir, "it is a folder"),
        (os.mkfifo, "not a file"),
        (lambda path: path.symlink_to("elsewhere/host.journal"), "it is a link that leads nowhere"),
        (lambda path: path.symlink_to(path), "it is a link that leads nowhere"),
    ],
)
def test_a_path_that_is_no_journal_is_refused_and_not_replaced(
    tmp_path: Path, create: Callable[[Path], None], reason: str
) -> None:
    path = tmp_path / "host.journal"
    create(path)
    before = path.lstat().st_ino
    with pytest.raises(JournalError) as found:
        FileJournal(path, OWNER, print, ManualClock())
    assert (found.value.exit_status, path.lstat().st_ino) == (73, before)
    assert str(found.value) == (
        f"cannot use the journal {path}: {reason}; "
        "put the journal back, or remove it: this host then starts with an empty one"
    )
    with pytest.raises(InputFileError, match=reason):
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


# --- damage -------------------------------------------------------------------------------------------


def test_no_record_is_lost_without_a_report_for_any_damage(bench: FileBench) -> None:
    data, rng = filled(bench), random.Random(0)
    identity = bench.open().identity
    bench.end()
    for _ in range(40):
        damaged = bytearray(data)
        if rng.random() < 0.5:
            at = 4096 * rng.randrange(len(data) // 4096)
            damaged[at : at + 4096] = rng.randbytes(4096)
        else:
            damaged[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        bench.path.write_bytes(damaged)
        bench.reports.clear()
        journal = FileJournal(bench.path, OWNER, bench.reports.append, bench.clock)
        journal.close()
        assert all(page in PAGES for page in journal.records())
        if len(journal.records()) < len(PAGES):
            assert bench.reports
            assert journal.identity != identity


@pytest.mark.parametrize(
    ("damage", "minimum"),
    [
        (lambda data: b"", 0),
        (lambda data: b"no database at all", 0),
        (lambda data: data[: len(data) // 2], 5),
        (lambda data: data[: 12 * 4096] + bytes(4096) + data[13 * 4096 :], 15),
        (lambda data: data.replace(b"CREATE TABLE damaged", b"CREATE \x87ABLE damaged"), 20),
        (lambda data: bytes(4096) + data[4096:], 20),
        (lambda data: b"SQLite format 3\0" + bytes(data)[16:100] + bytes(3996) + data[4096:], 20),
    ],
    ids=["empty", "no database", "truncated", "zeroed page", "no schema", "no first page", "no tables"],
)
def test_a_damaged_file_is_moved_aside_and_readable_records_are_kept(
    bench: FileBench, damage: Callable[[bytes], bytes], minimum: int
) -> None:
    data = damage(filled(bench))
    bench.path.write_bytes(data)
    if minimum:
        assert len(open_read_only(bench.path).records) >= minimum
    journal = bench.open()
    assert len(journal.records()) >= minimum
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
    rename, remaining = Path.rename, [0]

    def rename_until_killed(path: Path, target: Path) -> Path:
        remaining[0] -= 1
        if remaining[0] < 0:
            raise KeyboardInterrupt
        return rename(path, target)

    for renames in range(4):
        remaining[0] = renames
        for old in bench.path.parent.iterdir():
            old.unlink()
        bench.path.write_bytes(data)
        with monkeypatch.context() as patch:
            patch.setattr(Path, "rename", rename_until_killed)
            with pytest.raises(KeyboardInterrupt):
                FileJournal(bench.path, OWNER, bench.reports.append, bench.clock)
        journal = FileJournal(bench.path, OWNER, bench.reports.append, bench.clock)
        journal.close()
        assert len(journal.records()) >= 5
        assert bench.path.with_name("host.journal.damaged-1").read_bytes()[:50_000] == data


def test_a_damaged_record_is_kept_for_inspection(bench: FileBench) -> None:
    filled(bench)
    bench.sql("UPDATE pages SET body = x'00' WHERE name = 'agent3'")
    assert [record.entry.key.name for record in open_read_only(bench.path).damaged] == ["agent3"]
    bench.open()
    observed = open_read_only(bench.path)
    assert (len(observed.records), observed.damaged) == (19, [])
    assert [(record.entry.key.name, record.reason) for record in observed.moved_aside] == [
        ("agent3", "its checksum does not fit")
    ]


# --- a killed process ---------------------------------------------------------------------------------


@pytest.mark.process
def test_a_killed_process_has_stored_every_reported_record_completely(bench: FileBench) -> None:
    writer = [sys.executable, str(Path(__file__).with_name("journal_writer.py")), str(bench.path.parent)]
    for _ in range(2):
        with subprocess.Popen(writer, stdout=subprocess.PIPE, text=True) as child:
            assert child.stdout is not None
            for _ in range(30):
                printed = int(child.stdout.readline())
            child.kill()
            printed = int((child.stdout.read().split() or [printed])[-1])
    journal = FileJournal(bench.path, OWNER, bench.reports.append, bench.clock)
    journal.close()
    starts, copy = journal.records()
    assert isinstance(starts, StartCounter)
    assert isinstance(copy, CoordinatorRecord)
    assert starts.count in (printed, printed + 1)
    assert copy.sequence == starts.count
    assert copy.block == starts.count.to_bytes(8, "big") * 1000
    assert bench.reports == []
    assert RunMarker(True) not in journal.records()

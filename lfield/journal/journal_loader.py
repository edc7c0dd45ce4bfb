"""Opens a journal: checks the owner, separates valid from damaged records, moves damaged files aside."""

from __future__ import annotations

import os
import secrets
import sqlite3
import stat
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from lfield.errors import ForeignJournal, JournalError
from lfield.journal.records import (
    CoordinatorRecord,
    JournalEntry,
    PendingCallRecord,
    Record,
    RecordError,
    RecordKey,
    RunMarker,
    StartCounter,
    UnsupportedRecordVersion,
    decode_record,
)
from lfield.journal.salvage import salvage_database
from lfield.journal.store import APPLICATION, FORMAT, BrokenFile, DamagedEntry, JournalHeader, Store
from lfield.journal.wal import clear_dirty_flag, is_wal_missing, read_wal, sync_folder

#: The consequence of a lost promise (quorum vote).
NO_RECORD = RecordKey("starts")


class JournalOwner(NamedTuple):
    """The expected owner of a journal: deployment and host by name, the computer by `machine_id`."""

    deployment: str
    host: str
    machine: str


class LoadedJournal(NamedTuple):
    """A journal of this host, and every readable record with its entry."""

    store: Store
    header: JournalHeader
    records: dict[RecordKey, tuple[JournalEntry, Record]]


class JournalScan(NamedTuple):
    """Result of reading a journal: each valid record with its entry, and the damaged entries."""

    valid: dict[RecordKey, tuple[JournalEntry, Record]]
    damaged: list[DamagedEntry]


def open_journal(path: Path, owner: JournalOwner, report: Callable[[str], None], now: float) -> LoadedJournal:
    """Open the journal at a path; create it if there is none. `report` receives sentences about damage.

    `now` is Unix time in seconds. Raises ForeignJournal, JournalError for a path that is not a file, and
    sqlite3.Error or OSError if it can neither be read nor moved aside.
    """
    _finish_replacement(path)
    if fault := unusable_reason(path):
        raise JournalError(
            str(path), fault, "put the journal back, or remove it: this host then starts with an empty one"
        )
    if not path.exists():
        _write_journal(path, _new_head(owner), {}, [], now)
        with suppress(OSError):
            # The folder may also be new.
            sync_folder(path.parent.parent)
    try:
        check_wal(path)
        return _load(path, owner, report, now)
    except sqlite3.DatabaseError as error:
        if not is_damage(error):
            raise
        _salvage_file(path, owner, report, now, str(error))
    return _load(path, owner, report, now)


def unusable_reason(path: Path) -> str:
    """The reason why the path cannot be a journal; '' for a regular file or a missing one."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        # A symbolic link leads to a journal in another place, which must not be lost.
        return "it is a link that leads nowhere" if os.path.islink(path) else ""
    if stat.S_ISDIR(mode):
        return "it is a folder"
    return "" if stat.S_ISREG(mode) else "not a file"


def is_damage(error: sqlite3.Error) -> bool:
    """Whether an error is due to the contents of the file, and not to the disk or the folder."""
    if isinstance(error, BrokenFile):
        return True
    # SQLITE_ERROR means that a table or column is missing.
    return primary_code(error) in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR)


def primary_code(error: sqlite3.Error) -> int:
    """SQLite's result code without its extension, 0 for none."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF


def check_wal(path: Path) -> None:
    """Check that SQLite will not silently lose commits of the log. Raises BrokenFile and OSError."""
    if is_wal_missing(path):
        raise BrokenFile(_WAL_MISSING)
    if fault := read_wal(path).fault:
        raise BrokenFile(fault)


def check_format(path: Path, store: Store) -> None:
    """Check that the database is a journal of a supported version. Raises ForeignJournal and BrokenFile."""
    if store.application_id() != APPLICATION:
        raise BrokenFile("it is not the database of a journal")
    if store.format_version() > FORMAT:
        raise _unsupported_version(
            path, f"it has format {store.format_version()}, this lfield reads format {FORMAT}"
        )


def classify_entries(
    path: Path,
    entries: Iterable[tuple[int, JournalEntry]],
    *,
    may_be_stale: bool = False,
    attempts: bool = False,
) -> JournalScan:
    """Separate valid from damaged entries. Raises ForeignJournal for a record of a newer version.

    `may_be_stale`: records may be older than the newest stored ones, so mutable records are not trusted.
    `attempts`: the records are not used, so a record of a newer version only counts as unreadable.
    """
    scan = JournalScan({}, [])
    for place, entry in entries:
        try:
            record = decode_record(entry)
        except UnsupportedRecordVersion as error:
            if not attempts:
                raise _unsupported_version(path, f"{describe_loss(entry)}: {error}") from None
            scan.damaged.append(DamagedEntry(entry, f"{error}: install the lfield that wrote it", place))
            continue
        except RecordError as error:
            scan.damaged.append(DamagedEntry(entry, str(error), place))
            continue
        if may_be_stale and _is_mutable(record):
            scan.damaged.append(DamagedEntry(entry, "a later one may have been lost with the log", place))
            continue
        other = scan.valid.get(entry.key)
        if other is None or other[0].written_at <= entry.written_at:
            scan.valid[entry.key] = entry, record
    return scan


def _is_mutable(record: Record) -> bool:
    """Whether a later record with this key may differ, which is not the case for programs and endings."""
    if isinstance(record, PendingCallRecord):
        return not record.outcome
    return isinstance(record, StartCounter | RunMarker) or (
        isinstance(record, CoordinatorRecord) and record.state != "EXITED"
    )


def is_promise_lost(entry: JournalEntry) -> bool:
    """Whether a quorum vote is lost with this entry, as far as its key can be trusted.

    If so, the start counter is also lost: the host must contact all others before it votes again.
    """
    return entry.key.kind not in ("copy", "starts", "run", "paused", "stopped", "program", "reservation")


def describe_loss(entry: JournalEntry) -> str:
    """A description of a record by its subject and time, as far as its key and time can be trusted."""
    kind, name, number = entry.key
    meanings = {
        "copy": f"the copy of {name}, start {number}",
        "begun": f"call {number} started here by start {str(name).replace(chr(32), ' of ', 1)}",
        "reservation": f"the reservation of {name}",
        "starts": "the count of starts",
        "run": "whether the last run continues",
        "paused": "whether the mission is paused here",
        "stopped": "whether an emergency stop holds here",
        "fence": f"the fence of {name}",
        "program": f"the program {str(name)[:16]}",
    }.get(kind, f"a page {kind!r}")
    return f"{meanings}, stored {format_time(entry.written_at)}"


def format_time(seconds: float) -> str:
    """A wall-clock time in UTC."""
    try:
        return time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(seconds))
    except (OverflowError, ValueError, TypeError, OSError):
        return "an unknown time"


def _load(path: Path, owner: JournalOwner, report: Callable[[str], None], now: float) -> LoadedJournal:
    store = Store.open(path)
    try:
        check_format(path, store)
        head = store.head()
        if head is not None:
            _check_owner(path, head, owner)
        if fault := store.fault():
            raise BrokenFile(fault)
        scan = classify_entries(path, store.entries())
        if head is None or scan.damaged:
            head = _new_head(owner)
            if any(is_promise_lost(damage.entry) for damage in scan.damaged):
                scan.valid.pop(NO_RECORD, None)
                store.commit([((), [NO_RECORD])])
            store.move_aside(scan.damaged, head, now)
            _report_damage(path, scan.damaged, report)
    except BaseException:
        store.close()
        raise
    return LoadedJournal(store, head, scan.valid)


def _salvage_file(
    path: Path, owner: JournalOwner, report: Callable[[str], None], now: float, reason: str
) -> None:
    """Move a whole file aside, after its readable records were written into a new file."""
    salvaged = salvage_database(path)
    if salvaged.header is not None:
        _check_owner(path, salvaged.header, owner)
    scan = classify_entries(path, salvaged.entries.items(), may_be_stale=salvaged.may_be_stale)
    is_whole = salvaged.is_complete and not scan.damaged
    head = salvaged.header if is_whole and salvaged.header is not None else _new_head(owner)
    if not salvaged.is_complete or any(is_promise_lost(damage.entry) for damage in scan.damaged):
        # The type of a missing record is unknown.
        scan.valid.pop(NO_RECORD, None)
    new_name = _write_journal(path, head, scan.valid, scan.damaged, now)
    count = len(scan.valid)
    report(
        f"the journal {path} is damaged ({reason}) and is now {new_name}: {count} page{'s' * (count != 1)} "
        f"of it could be read and count; {_NOTHING_LOST if is_whole else _PROMISES_LOST}"
    )
    _report_damage(path, scan.damaged, report)


#: The consequence for the team when records are lost; the journal has a new id from then on.
_PROMISES_LOST = (
    "a coordinator of which nothing is left was lost with it, and transfers that were under way to this host "
    "stay in doubt: 'lfield ps' shows them"
)


_NOTHING_LOST = "nothing is lost"
_WAL_MISSING = "its log is missing"


def _report_damage(path: Path, damaged: Iterable[DamagedEntry], report: Callable[[str], None]) -> None:
    for damage in damaged:
        report(
            f"{describe_loss(damage.entry)}, is damaged in the journal {path} ({damage.reason}); "
            f"it was moved aside, the rest counts; {_PROMISES_LOST}"
        )


# --- files --------------------------------------------------------------------------------------------


def _write_journal(
    path: Path,
    head: JournalHeader,
    valid: dict[RecordKey, tuple[JournalEntry, Record]],
    damaged: list[DamagedEntry],
    now: float,
) -> str:
    """Replace the file at the path by a valid journal; returns the new name of the old file, '' for none."""
    making = path.with_name(f"{path.name}.making")
    for suffix in ("", "-journal", "-wal", "-shm"):
        making.with_name(making.name + suffix).unlink(missing_ok=True)
    # SQLite gives its other files the same permissions.
    os.close(os.open(making, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600))
    Store.create(making, head, [entry for entry, _ in valid.values()], damaged, now)
    making.rename(_replacement_path(path))
    return _finish_replacement(path)


def _finish_replacement(path: Path) -> str:
    """Complete the replacement of a journal, also after a crash during an earlier attempt."""
    whole = _replacement_path(path)
    if not whole.exists():
        return ""
    new_path = _aside_path(path)
    # The log is first, because it must not be used with the new file.
    for suffix in ("-wal", ""):
        with suppress(FileNotFoundError):
            path.with_name(path.name + suffix).rename(new_path.with_name(new_path.name + suffix))
    path.with_name(f"{path.name}-shm").unlink(missing_ok=True)
    clear_dirty_flag(path)
    whole.rename(path)
    sync_folder(path.parent)
    return new_path.name


def _replacement_path(path: Path) -> Path:
    return path.with_name(f"{path.name}.whole")


def _aside_path(path: Path) -> Path:
    number = 1
    while (new_path := path.with_name(f"{path.name}.damaged-{number}")).exists():
        number += 1
    return new_path


# --- owner ----------------------------------------------------------------------------------------


def _new_head(owner: JournalOwner) -> JournalHeader:
    return JournalHeader(secrets.randbits(63), *owner)


def _check_owner(path: Path, head: JournalHeader, owner: JournalOwner) -> None:
    if (head.deployment, head.host) != (owner.deployment, owner.host):
        raise ForeignJournal(
            str(path),
            f"it is that of {head.host} in {head.deployment}, and this is {owner.host} in {owner.deployment}",
            "put it back where it belongs, or name another --state",
        )
    if head.machine not in ("", owner.machine):
        raise ForeignJournal(
            str(path),
            "it was written on another computer, where its coordinators may still run",
            "use it there; if that computer is lost permanently, remove this journal: the host then starts "
            "with an empty one",
        )


def _unsupported_version(path: Path, reason: str) -> ForeignJournal:
    return ForeignJournal(str(path), reason, "install the version of lfield that wrote it")

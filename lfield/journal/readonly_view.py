"""Read-only access to a journal, also while a host uses it, and also if it is damaged."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from lfield.errors import DamagedFileError, InputFileError
from lfield.journal.journal_loader import (
    check_format,
    check_wal,
    classify_entries,
    is_damage,
    primary_code,
    unusable_reason,
)
from lfield.journal.records import JournalEntry, Record
from lfield.journal.salvage import salvage_database, temporary_copy
from lfield.journal.store import BrokenFile, DamagedEntry, JournalHeader, Store
from lfield.text.input_files import require_file

#: SQLite's error without write permission: SQLite needs a shared-memory index next to the log, also for
#: reading.
_NO_INDEX = (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM)


#: The number of times that a seemingly damaged log is read again, and the delay between two reads in seconds.
ATTEMPTS, RETRY_DELAY = 3, 0.05


class ReadOnlyView(NamedTuple):
    """The contents of a journal. `header` is None if the header is damaged; `fault` is the fault of the file.

    `moved_aside` are damaged entries that were moved aside when a host opened the journal, `damaged` the
    damaged entries among the records.
    """

    header: JournalHeader | None
    records: list[tuple[JournalEntry, Record]]
    damaged: list[DamagedEntry]
    moved_aside: list[DamagedEntry]
    fault: str


def open_read_only(path: Path) -> ReadOnlyView:
    """All readable contents. Raises InputFileError, DamagedFileError and ForeignJournal."""
    if fault := unusable_reason(path):
        # Opening a pipe would block until a writer opens it.
        raise InputFileError(str(path), fault)
    require_file(path)
    try:
        try:
            return _read_valid(path)
        except sqlite3.DatabaseError as error:
            if not is_damage(error):
                raise InputFileError(str(path), str(error)) from None
            found = _read_damaged(path, str(error))
    except OSError as error:
        raise InputFileError(str(path), (error.strerror or str(error)).lower()) from None
    if found.header is None and not found.records:
        raise DamagedFileError(str(path), f"not a journal, or completely damaged: {found.fault}")
    return found


@contextmanager
def _store(path: Path) -> Iterator[Store]:
    store = _open_in_place(path)
    if store is not None:
        with closing(store):
            yield store
        return
    # A read-only file does not change during the read.
    with temporary_copy(path) as copy, closing(Store.open_read_only(copy)) as store:
        yield store


def _open_in_place(path: Path) -> Store | None:
    """The contents of the journal in place; None if SQLite needs to write but may not. Raises
    sqlite3.Error.
    """
    store = Store.open_read_only(path)
    try:
        store.format_version()
        return store
    except sqlite3.Error as error:
        store.close()
        if primary_code(error) in _NO_INDEX:
            return None
        raise


def _read_valid(path: Path) -> ReadOnlyView:
    """The contents of a valid database. Raises sqlite3.DatabaseError for a file that is damaged as a
    whole.
    """
    _check_wal(path)
    with _store(path) as store:
        check_format(path, store)
        if fault := store.fault():
            raise BrokenFile(fault)
        found = classify_entries(path, store.entries(), attempts=True)
        return ReadOnlyView(store.head(), list(found.valid.values()), found.damaged, store.damaged(), "")


def _check_wal(path: Path) -> None:
    """Reads the log, which may appear damaged while it is written. Raises BrokenFile."""
    for _ in range(ATTEMPTS - 1):
        with suppress(BrokenFile):
            check_wal(path)
            return
        time.sleep(RETRY_DELAY)
    check_wal(path)


def _read_damaged(path: Path, fault: str) -> ReadOnlyView:
    salvaged = salvage_database(path)
    found = classify_entries(
        path, salvaged.entries.items(), may_be_stale=salvaged.may_be_stale, attempts=True
    )
    return ReadOnlyView(salvaged.header, list(found.valid.values()), found.damaged, [], fault)

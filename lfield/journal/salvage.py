"""Salvages records from a copy of a damaged database, which is repaired until SQLite can read it.

SQLite refuses a file that is shorter than its first page states, or whose first page is damaged. A short file
is padded with zeros; a damaged first page is replaced by that of a new journal, since the tables of all
journals begin at the same pages. A damaged log is applied frame by frame. Only records with a correct
checksum count.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import struct
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from lfield.journal.records import JournalEntry
from lfield.journal.store import JournalHeader, Store
from lfield.journal.wal import is_wal_missing, read_wal, rebuild_database, wal_file

#: Offsets in SQLite's first page: the page size, and the number of pages.
_PAGE_SIZE, _PAGES = struct.Struct(">16xH"), struct.Struct(">28xI")
#: SQLite's default page size.
_PAGE = 4096


class SalvageResult(NamedTuple):
    """The salvaged contents: the owner of the journal, if known, and entries by position.

    `is_complete`: only the log was damaged, and no entry is missing. `may_be_stale`: entries may be older
    than the newest ones.
    """

    header: JournalHeader | None
    entries: dict[int, JournalEntry]
    is_complete: bool = False
    may_be_stale: bool = False


@contextmanager
def temporary_copy(path: Path) -> Iterator[Path]:
    """A copy of a database and its log for the duration. Raises OSError."""
    with tempfile.TemporaryDirectory(prefix="lfield-") as folder:
        copy = Path(folder) / path.name
        shutil.copyfile(path, copy)
        with suppress(FileNotFoundError):
            shutil.copyfile(wal_file(path), wal_file(copy))
        yield copy


def salvage_database(path: Path) -> SalvageResult:
    """All readable contents of a database. Raises OSError."""
    with temporary_copy(path) as copy:
        is_merged = _merge_wal(copy)
        _pad_file(copy)
        found = _read(copy)
    if not found.entries:
        with temporary_copy(path) as copy:
            is_merged = _merge_wal(copy)
            _replace_first_page(copy)
            found = _read(copy)
    is_stale = is_merged is False or is_wal_missing(path)
    return found._replace(is_complete=bool(is_merged) and found.is_complete, may_be_stale=is_stale)


def read_both_ends(store: Store) -> dict[int, JournalEntry]:
    """Read from both ends up to the damage."""
    found: dict[int, JournalEntry] = {}
    for backwards in (False, True):
        with suppress(sqlite3.DatabaseError):
            found.update(store.entries(backwards=backwards))
    return found


def _read(copy: Path) -> SalvageResult:
    head, entries, whole = None, {}, False
    with suppress(sqlite3.Error), closing(Store.open(copy)) as store:
        entries = read_both_ends(store)
        head = store.head()
        whole = head is not None and not store.fault()
    return SalvageResult(head, entries, whole)


def _merge_wal(copy: Path) -> bool | None:
    """Apply a damaged log to a copy; returns whether the result is complete, None if the log is not
    damaged.
    """
    log = read_wal(copy)
    if not log.fault:
        return None
    image, whole = rebuild_database(copy.read_bytes(), log)
    copy.write_bytes(image)
    wal_file(copy).unlink()
    return whole


def _pad_file(copy: Path) -> None:
    start = copy.read_bytes()[:100]
    if len(start) < _PAGES.size:
        return
    size = _PAGE_SIZE.unpack_from(start)[0] * _PAGES.unpack_from(start)[0]
    # The number is limited, because a sparse file takes no space, but takes time to read.
    if copy.stat().st_size < size < 1 << 32:
        os.truncate(copy, size)


def _replace_first_page(copy: Path) -> None:
    new = copy.with_name("new")
    with suppress(sqlite3.Error):
        Store.create(new, JournalHeader(0, "", "", ""))
        page_count = -(-copy.stat().st_size // _PAGE)
        first = bytearray(new.read_bytes()[:_PAGE])
        struct.pack_into(">I", first, _PAGES.size - 4, page_count)
        with copy.open("r+b") as file:
            file.write(first)
        os.truncate(copy, page_count * _PAGE)

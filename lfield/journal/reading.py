"""A journal that is only looked at: also while a host has it, and also when it is damaged."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from lfield.errors import DamagedFileError, InputFileError
from lfield.journal.opening import check_format, check_log, is_damage, primary, sort, strange
from lfield.journal.pages import Entry, Page
from lfield.journal.salvage import copied, readable
from lfield.journal.store import BrokenFile, Damaged, Head, Store
from lfield.text.files import look_at

#: What SQLite says where it may not write: it keeps an index of the log beside it, also for readers.
_NO_INDEX = (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM)


#: A log that seems to be damaged is looked at so often, with so many seconds between.
LOOKS, BETWEEN = 3, 0.05


class Seen(NamedTuple):
    """What is in a journal. `head` is None when that is damaged; `fault` is what is wrong with the file.

    `aside` was damaged and was moved aside when a host opened the journal, `damaged` lies among the pages.
    """

    head: Head | None
    pages: list[tuple[Entry, Page]]
    damaged: list[Damaged]
    aside: list[Damaged]
    fault: str


def see(path: Path) -> Seen:
    """All that can be read. Raises InputFileError, DamagedFileError and ForeignJournal."""
    if fault := strange(path):
        # Whoever opens a pipe waits until somebody writes to it.
        raise InputFileError(str(path), fault)
    look_at(path)
    try:
        try:
            return _sound(path)
        except sqlite3.DatabaseError as error:
            if not is_damage(error):
                raise InputFileError(str(path), str(error)) from None
            found = _broken(path, str(error))
    except OSError as error:
        raise InputFileError(str(path), (error.strerror or str(error)).lower()) from None
    if found.head is None and not found.pages:
        raise DamagedFileError(str(path), f"it is no journal, or nothing of it is left: {found.fault}")
    return found


@contextmanager
def _store(path: Path) -> Iterator[Store]:
    store = _in_place(path)
    if store is not None:
        with closing(store):
            yield store
        return
    # Where nobody may write, nobody changes it meanwhile.
    with copied(path) as copy, closing(Store.look_at(copy)) as store:
        yield store


def _in_place(path: Path) -> Store | None:
    """None where SQLite needs to write and may not. Raises sqlite3.Error."""
    store = Store.look_at(path)
    try:
        store.version()
        return store
    except sqlite3.Error as error:
        store.close()
        if primary(error) in _NO_INDEX:
            return None
        raise


def _sound(path: Path) -> Seen:
    """Raises sqlite3.DatabaseError for a file that is damaged as a whole."""
    _check_log(path)
    with _store(path) as store:
        check_format(path, store)
        if fault := store.fault():
            raise BrokenFile(fault)
        found = sort(path, store.entries(), looks=True)
        return Seen(store.head(), list(found.sound.values()), found.damaged, store.damaged(), "")


def _check_log(path: Path) -> None:
    """A log that is just being written may look damaged, but not for long. Raises BrokenFile."""
    for _ in range(LOOKS - 1):
        with suppress(BrokenFile):
            check_log(path)
            return
        time.sleep(BETWEEN)
    check_log(path)


def _broken(path: Path, fault: str) -> Seen:
    left = readable(path)
    found = sort(path, left.entries.items(), outrun=left.outrun, looks=True)
    return Seen(left.head, list(found.sound.values()), found.damaged, [], fault)

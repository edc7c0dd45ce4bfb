"""A journal that is only looked at: also while a host has it, and also when it is damaged."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from lfield.errors import DamagedFileError, InputFileError
from lfield.journal.opening import BrokenFile, check_format, is_damage, primary, sort
from lfield.journal.pages import Entry, Page
from lfield.journal.store import Damaged, Head, Store
from lfield.text.files import look_at

#: What SQLite says where it may not write: it keeps an index of the log beside it, also for readers.
_NO_INDEX = (sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_READONLY, sqlite3.SQLITE_PERM)


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
    look_at(path)
    try:
        with _store(path) as store:
            return _seen(path, store)
    except BrokenFile as error:
        raise DamagedFileError(str(path), str(error)) from None
    except sqlite3.Error as error:
        kind = DamagedFileError if is_damage(error) else InputFileError
        raise kind(str(path), str(error)) from None
    except OSError as error:
        raise InputFileError(str(path), (error.strerror or str(error)).lower()) from None


@contextmanager
def _store(path: Path) -> Iterator[Store]:
    store = _in_place(path)
    if store is not None:
        with closing(store):
            yield store
        return
    # Where nobody may write, nobody changes it meanwhile.
    with tempfile.TemporaryDirectory(prefix="lfield-") as folder:
        copy = Path(folder) / path.name
        for ending in ("", "-wal"):
            with suppress(FileNotFoundError):
                shutil.copyfile(path.with_name(path.name + ending), copy.with_name(copy.name + ending))
        with closing(Store.look_at(copy)) as store:
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


def _seen(path: Path, store: Store) -> Seen:
    check_format(path, store)
    head = aside = None
    try:
        fault = store.fault()
        head, aside = store.head(), store.damaged()
    except sqlite3.DatabaseError as error:
        fault = str(error)
    found: dict[int, Entry] = {}
    for backwards in (False, True):
        with suppress(sqlite3.DatabaseError):
            found.update(store.entries(backwards=backwards))
    sorted_ = sort(path, found.items())
    return Seen(head, list(sorted_.sound.values()), sorted_.damaged, aside or [], fault)

"""What can still be read of a damaged database: of a copy, which is mended until SQLite reads on.

SQLite refuses a file that is shorter than its first page says, or whose first page is damaged. The first is
made longer, with nothing in it; the second gets the first page of a new journal, for the tables of all
journals begin at the same places. A log that is damaged is worked in frame by frame. What is read is believed
only where its checksum fits.
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

from lfield.journal.log import is_missing, log_file, read_log, rebuilt
from lfield.journal.pages import Entry
from lfield.journal.store import Head, Store

#: In SQLite's first page: its size, and how many there are.
_PAGE_SIZE, _PAGES = struct.Struct(">16xH"), struct.Struct(">28xI")
#: The size that SQLite gives them by itself.
_PAGE = 4096


class Readable(NamedTuple):
    """What was read: whose journal it is, if that is known, and entries by their places.

    `whole`: only its log was damaged, and nothing is missing. `outrun`: entries may be older than the newest.
    """

    head: Head | None
    entries: dict[int, Entry]
    whole: bool = False
    outrun: bool = False


@contextmanager
def copied(path: Path) -> Iterator[Path]:
    """A copy of a database and its log for the duration. Raises OSError."""
    with tempfile.TemporaryDirectory(prefix="lfield-") as folder:
        copy = Path(folder) / path.name
        shutil.copyfile(path, copy)
        with suppress(FileNotFoundError):
            shutil.copyfile(log_file(path), log_file(copy))
        yield copy


def readable(path: Path) -> Readable:
    """All that can be read of a database. Raises OSError."""
    with copied(path) as copy:
        mended = _work_in(copy)
        _lengthen(copy)
        found = _read(copy)
    if not found.entries:
        with copied(path) as copy:
            mended = _work_in(copy)
            _give_first_page(copy)
            found = _read(copy)
    outrun = mended is False or is_missing(path)
    return found._replace(whole=bool(mended) and found.whole, outrun=outrun)


def read_through(store: Store) -> dict[int, Entry]:
    """From both ends up to where it is damaged."""
    found: dict[int, Entry] = {}
    for backwards in (False, True):
        with suppress(sqlite3.DatabaseError):
            found.update(store.entries(backwards=backwards))
    return found


def _read(copy: Path) -> Readable:
    head, entries, whole = None, {}, False
    with suppress(sqlite3.Error), closing(Store.open(copy)) as store:
        entries = read_through(store)
        head = store.head()
        whole = head is not None and not store.fault()
    return Readable(head, entries, whole)


def _work_in(copy: Path) -> bool | None:
    """Work a damaged log into a copy: whether nothing of it is missing, None where it is not damaged."""
    log = read_log(copy)
    if not log.fault:
        return None
    image, whole = rebuilt(copy.read_bytes(), log)
    copy.write_bytes(image)
    log_file(copy).unlink()
    return whole


def _lengthen(copy: Path) -> None:
    start = copy.read_bytes()[:100]
    if len(start) < _PAGES.size:
        return
    size = _PAGE_SIZE.unpack_from(start)[0] * _PAGES.unpack_from(start)[0]
    # Nobody believes a damaged number for long: a file of holes takes no room, but time to be read.
    if copy.stat().st_size < size < 1 << 32:
        os.truncate(copy, size)


def _give_first_page(copy: Path) -> None:
    new = copy.with_name("new")
    with suppress(sqlite3.Error):
        Store.create(new, Head(0, "", "", ""))
        pages = -(-copy.stat().st_size // _PAGE)
        first = bytearray(new.read_bytes()[:_PAGE])
        struct.pack_into(">I", first, _PAGES.size - 4, pages)
        with copy.open("r+b") as file:
            file.write(first)
        os.truncate(copy, pages * _PAGE)

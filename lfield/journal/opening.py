"""How a journal is opened: whose it is, what of it can be believed, and what is moved aside."""

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
from lfield.journal.log import is_missing, read_log, sync_folder, unmark
from lfield.journal.pages import (
    BegunPage,
    CopyPage,
    Entry,
    Key,
    NewerPage,
    Page,
    PageError,
    Run,
    Starts,
    page_of,
)
from lfield.journal.salvage import readable
from lfield.journal.store import APPLICATION, FORMAT, BrokenFile, Damaged, Head, Store

#: What goes with a promise that is lost.
NO_RECORD = Key("starts")


class Owner(NamedTuple):
    """Whose a journal should be: deployment and host by name, the computer by `machine_identity`."""

    deployment: str
    host: str
    machine: str


class Opened(NamedTuple):
    """A journal that is ours, and all that can be read in it: each page with its entry."""

    store: Store
    head: Head
    pages: dict[Key, tuple[Entry, Page]]


class Sorted(NamedTuple):
    """What was found in a journal: each page with its entry, and what cannot be believed."""

    sound: dict[Key, tuple[Entry, Page]]
    damaged: list[Damaged]


def opened(path: Path, owner: Owner, tell: Callable[[str], None], now: float) -> Opened:
    """The journal at a path; a new one if there is none. `tell` hears what is wrong with it.

    `now` is Unix time in seconds. Raises ForeignJournal, JournalError for what is no file, and sqlite3.Error
    or OSError when it can neither be read nor moved aside.
    """
    _finish(path)
    if fault := strange(path):
        raise JournalError(str(path), fault, "put the journal back, or remove it: then this host begins anew")
    if not path.exists():
        _put(path, _new_head(owner), {}, [], now)
        with suppress(OSError):
            # Its folder may be new, too.
            sync_folder(path.parent.parent)
    try:
        check_log(path)
        return _read(path, owner, tell, now)
    except sqlite3.DatabaseError as error:
        if not is_damage(error):
            raise
        _salvage(path, owner, tell, now, str(error))
    return _read(path, owner, tell, now)


def strange(path: Path) -> str:
    """Why what is there can be no journal; '' for a file, and for nothing at all."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):
        # Whoever made the link has put the journal elsewhere: what is kept there is not to be forgotten.
        return "it is a link that leads nowhere" if os.path.islink(path) else ""
    if stat.S_ISDIR(mode):
        return "it is a folder"
    return "" if stat.S_ISREG(mode) else "it is no file"


def is_damage(error: sqlite3.Error) -> bool:
    """Whether an error tells of what is in the file; else it tells of the disk or the folder."""
    if isinstance(error, BrokenFile):
        return True
    # An SQLITE_ERROR means that a table or column is not there.
    return primary(error) in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR)


def primary(error: sqlite3.Error) -> int:
    """SQLite's result code without its extension, 0 for none."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF


def check_log(path: Path) -> None:
    """See that SQLite will lose no commits of the log in silence. Raises BrokenFile, and OSError."""
    if is_missing(path):
        raise BrokenFile(_NO_LOG)
    if fault := read_log(path).fault:
        raise BrokenFile(fault)


def check_format(path: Path, store: Store) -> None:
    """See that it is a journal, and not of a newer version. Raises ForeignJournal and BrokenFile."""
    if store.application() != APPLICATION:
        raise BrokenFile("it is not the database of a journal")
    if store.version() > FORMAT:
        raise _newer(path, f"it has format {store.version()}, this lfield reads format {FORMAT}")


def sort(
    path: Path, entries: Iterable[tuple[int, Entry]], *, outrun: bool = False, looks: bool = False
) -> Sorted:
    """Tell what can be believed from what cannot. Raises ForeignJournal for a page of a newer version.

    `outrun`: pages may be older than the newest that were kept, so those that change cannot be believed.
    `looks`: nothing is done with them, so one of a newer version is only one more that cannot be read.
    """
    found = Sorted({}, [])
    for place, entry in entries:
        try:
            page = page_of(entry)
        except NewerPage as error:
            if not looks:
                raise _newer(path, f"{lost(entry)}: {error}") from None
            found.damaged.append(Damaged(entry, f"{error}: install the lfield that wrote it", place))
            continue
        except PageError as error:
            found.damaged.append(Damaged(entry, str(error), place))
            continue
        if outrun and _changes(page):
            found.damaged.append(Damaged(entry, "a later one may have been lost with the log", place))
            continue
        other = found.sound.get(entry.key)
        if other is None or other[0].kept <= entry.kept:
            found.sound[entry.key] = entry, page
    return found


def _changes(page: Page) -> bool:
    """Whether a later page may say something else: not so of a program and of an ending."""
    if isinstance(page, BegunPage):
        return not page.outcome
    return isinstance(page, Starts | Run) or (isinstance(page, CopyPage) and page.state != "EXITED")


def forgets(entry: Entry) -> bool:
    """Whether a promise is lost with this page, as far as its key can be believed.

    Then there is no record of starts any more: without it a host hears all others before it promises anew.
    """
    return entry.key.kind not in ("copy", "starts", "run", "paused", "stopped", "program", "reservation")


def lost(entry: Entry) -> str:
    """What a page is about and since when, in words, as far as its key and time can be believed."""
    kind, name, number = entry.key
    words = {
        "copy": f"the copy of {name}, start {number}",
        "begun": f"call {number} that was begun here by start {str(name).replace(chr(32), ' of ', 1)}",
        "reservation": f"who has reserved {name}",
        "starts": "the count of starts",
        "run": "whether the last run goes on",
        "paused": "whether the mission is paused here",
        "stopped": "whether an emergency stop holds here",
        "fence": f"the fence of {name}",
        "program": f"the program {str(name)[:16]}",
    }.get(kind, f"a page {kind!r}")
    return f"{words}, as of {moment(entry.kept)}"


def moment(kept: float) -> str:
    """A time of the wall clock, in UTC."""
    try:
        return time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(kept))
    except (OverflowError, ValueError, TypeError, OSError):
        return "an unknown time"


def _read(path: Path, owner: Owner, tell: Callable[[str], None], now: float) -> Opened:
    store = Store.open(path)
    try:
        check_format(path, store)
        head = store.head()
        if head is not None:
            _check_owner(path, head, owner)
        if fault := store.fault():
            raise BrokenFile(fault)
        found = sort(path, store.entries())
        if head is None or found.damaged:
            head = _new_head(owner)
            if any(forgets(one.entry) for one in found.damaged):
                found.sound.pop(NO_RECORD, None)
                store.commit([((), [NO_RECORD])])
            store.move_aside(found.damaged, head, now)
            _tell_damage(path, found.damaged, tell)
    except BaseException:
        store.close()
        raise
    return Opened(store, head, found.sound)


def _salvage(path: Path, owner: Owner, tell: Callable[[str], None], now: float, why: str) -> None:
    """Move a whole file aside, after what can be read of it was written into another."""
    left = readable(path)
    if left.head is not None:
        _check_owner(path, left.head, owner)
    found = sort(path, left.entries.items(), outrun=left.outrun)
    whole = left.whole and not found.damaged
    head = left.head if whole and left.head is not None else _new_head(owner)
    if not left.whole or any(forgets(one.entry) for one in found.damaged):
        # Of what is missing nobody knows what it was.
        found.sound.pop(NO_RECORD, None)
    aside = _put(path, head, found.sound, found.damaged, now)
    count = len(found.sound)
    tell(
        f"the journal {path} is damaged ({why}) and is now {aside}: {count} page{'s' * (count != 1)} of it "
        f"could be read and count; {_NOTHING_LOST if whole else _FORGOTTEN}"
    )
    _tell_damage(path, found.damaged, tell)


#: What follows for the team when something is lost; its identity is another one from now on.
_FORGOTTEN = (
    "a coordinator of which nothing is left was lost with it, and transfers that were under way to this host "
    "stay in doubt: 'lfield ps' shows them"
)


_NOTHING_LOST = "nothing is lost"
_NO_LOG = "its log is missing"


def _tell_damage(path: Path, damaged: Iterable[Damaged], tell: Callable[[str], None]) -> None:
    for one in damaged:
        tell(
            f"{lost(one.entry)}, is damaged in the journal {path} ({one.why}); it was moved aside, the rest "
            f"counts; {_FORGOTTEN}"
        )


# --- files --------------------------------------------------------------------------------------------


def _put(
    path: Path, head: Head, sound: dict[Key, tuple[Entry, Page]], damaged: list[Damaged], now: float
) -> str:
    """Write a whole journal in the place of whatever is there; the name that this has then, '' for none."""
    making = path.with_name(f"{path.name}.making")
    for ending in ("", "-journal", "-wal", "-shm"):
        making.with_name(making.name + ending).unlink(missing_ok=True)
    # SQLite's other files are read by those who may read this one: by nobody else.
    os.close(os.open(making, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600))
    Store.create(making, head, [entry for entry, _ in sound.values()], damaged, now)
    making.rename(_whole(path))
    return _finish(path)


def _finish(path: Path) -> str:
    """Put a journal in its place that is written as a whole, also when a process ended while it did so."""
    whole = _whole(path)
    if not whole.exists():
        return ""
    aside = _aside(path)
    # The log first: it must not be taken for that of the new file.
    for ending in ("-wal", ""):
        with suppress(FileNotFoundError):
            path.with_name(path.name + ending).rename(aside.with_name(aside.name + ending))
    path.with_name(f"{path.name}-shm").unlink(missing_ok=True)
    unmark(path)
    whole.rename(path)
    sync_folder(path.parent)
    return aside.name


def _whole(path: Path) -> Path:
    return path.with_name(f"{path.name}.whole")


def _aside(path: Path) -> Path:
    number = 1
    while (aside := path.with_name(f"{path.name}.damaged-{number}")).exists():
        number += 1
    return aside


# --- whose it is --------------------------------------------------------------------------------------


def _new_head(owner: Owner) -> Head:
    return Head(secrets.randbits(63), *owner)


def _check_owner(path: Path, head: Head, owner: Owner) -> None:
    if (head.deployment, head.host) != (owner.deployment, owner.host):
        raise ForeignJournal(
            str(path),
            f"it is that of {head.host} in {head.deployment}, and this is {owner.host} in {owner.deployment}",
            "put it back where it belongs, or name another --state",
        )
    if head.machine not in ("", owner.machine):
        raise ForeignJournal(
            str(path),
            "it was begun on another computer, where what it tells of may still run",
            "use it there; if that computer is gone for good, remove it here: then this host begins anew",
        )


def _newer(path: Path, reason: str) -> ForeignJournal:
    return ForeignJournal(str(path), reason, "install the version of lfield that wrote it")

"""The journal of a host on its disk: a thread of its own commits, and the loop never waits for it."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

from lfield.clock import Clock
from lfield.errors import JournalError, OutputFileError
from lfield.journal.grouping import Grouped
from lfield.journal.journal import Change
from lfield.journal.log import log_file, mark, unmark
from lfield.journal.opening import Opened, Owner, opened, primary
from lfield.journal.owner import Lock
from lfield.journal.pages import BegunPage, CopyPage, Key, entry, key_of
from lfield.journal.reserve import Reserve
from lfield.journal.store import Store
from lfield.text.private import private_folder

_FULL = "its disk is full: it writes into the space that was kept in advance"
_NO_MORE = "its disk has room for what is here, and for no more"
#: Bytes for which room is kept for what a call gives that was begun.
RESULT = 1024
_MAKE_ROOM = "make room on that disk"

#: Why a disk takes nothing, and what to do, by SQLite's result codes.
_REASONS = {
    sqlite3.SQLITE_FULL: ("no space is left on its disk", _MAKE_ROOM),
    sqlite3.SQLITE_READONLY: ("its disk is read-only", "mount it for writing, or name another --state"),
    sqlite3.SQLITE_IOERR: ("its disk fails", "the system's log (dmesg) says why"),
    sqlite3.SQLITE_CANTOPEN: ("it cannot be opened", "see who may write there, or name another --state"),
    sqlite3.SQLITE_PERM: ("it may not be opened", "see who may write there, or name another --state"),
    sqlite3.SQLITE_BUSY: ("another program writes to it", "end that program"),
}


class FileJournal(Grouped):
    """See `Journal`. It is opened before the loop has anything to do, and closed after.

    `path` is that of `journal_file`; `tell` hears a sentence for all that was found damaged. Raises
    JournalError, JournalInUse and ForeignJournal.
    """

    def __init__(self, path: Path, owner: Owner, tell: Callable[[str], None], clock: Clock) -> None:
        self.path, self._clock = path, clock
        self.trouble = ""
        self._reserve = Reserve(path.with_name("host.reserve"))
        self._lock = _locked(path)
        try:
            self._store, head, pages = self._opened(owner, tell)
        except BaseException:
            self._lock.release()
            raise
        self.identity = head.identity
        super().__init__(pages, self._in_thread, clock)
        self._inode = path.stat().st_ino
        #: The number of the log's file, 0 until there is one.
        self._log = 0
        #: Bytes of each copy that is here, and of each result that is to come.
        self._held: dict[Key, int] = {}
        self._count([Change(self._read)])
        self.trouble = self._have_room()
        self._thread = ThreadPoolExecutor(1, "journal")
        self._closed = self._reopen = False

    # --- the journal ----------------------------------------------------------------------------------

    def close(self) -> None:
        """See `Journal`."""
        if self._closed:
            return
        self._closed = True
        self._thread.shutdown()
        unmark(self.path)
        with suppress(sqlite3.Error):
            self._store.close()
        self._lock.release()

    # --- in its thread --------------------------------------------------------------------------------

    async def _in_thread(self, changes: Sequence[Change]) -> None:
        if self._closed:
            raise JournalError(str(self.path), "it is closed")
        await asyncio.get_running_loop().run_in_executor(self._thread, self._commit, changes)

    def _commit(self, changes: Sequence[Change]) -> None:
        """All changes, or none. Raises JournalError."""
        try:
            self._see_that_it_is_there()
            trouble = self._have_room()
            try:
                self._write(changes)
            except sqlite3.Error as error:
                if primary(error) not in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR):
                    raise
                self._reserve.give_up()
                trouble = self._full
                # What is in the log already makes room for what comes.
                self._restart_log()
                self._write(changes)
        except (sqlite3.Error, OSError) as error:
            self._reopen = not (isinstance(error, sqlite3.Error) and primary(error) == sqlite3.SQLITE_FULL)
            failure = _failure(self.path, error)
            self.trouble = failure.reason
            raise failure from None
        self._count(changes)
        self._mark_log()
        self.trouble = trouble or self._have_room()
        if self.trouble:
            # The log must not grow into the room that is left.
            self._restart_log()

    def _write(self, changes: Sequence[Change]) -> None:
        now = self._clock.time()
        groups = [([entry(page, now) for page in pages], keys) for pages, keys in changes]
        if any(pages or keys for pages, keys in groups):
            self._store.commit(groups)
        else:
            self._store.try_out()

    def _see_that_it_is_there(self) -> None:
        """What is written into a file that was removed is on no disk. Raises OSError and sqlite3.Error."""
        if self.path.stat().st_ino != self._inode:
            raise FileNotFoundError(0, "another file was put in its place")
        if self._reopen or (self._log and _number(log_file(self.path)) != self._log):
            # What is in a log that was removed is worked into the database when that is closed.
            unmark(self.path)
            with suppress(sqlite3.Error):
                self._store.close()
            self._store = Store.open(self.path)
            self._reopen = False
            self._log = 0

    def _mark_log(self) -> None:
        if not self._log:
            self._log = _number(log_file(self.path))
            mark(self.path)

    # --- room -----------------------------------------------------------------------------------------

    def _count(self, changes: Sequence[Change]) -> None:
        for pages, keys in changes:
            for page in pages:
                if isinstance(page, CopyPage) and page.state in ("RUN", "PREPARED"):
                    self._held[key_of(page)] = len(page.block)
                elif isinstance(page, BegunPage) and not page.outcome:
                    self._held[key_of(page)] = RESULT
                else:
                    self._held.pop(key_of(page), None)
            for key in keys:
                self._held.pop(key, None)

    def _have_room(self) -> str:
        """Keep space in advance, if there is any; why there is none, '' if there is."""
        try:
            self._reserve.hold(sum(self._held.values()))
        except OSError:
            return self._full
        return ""

    @property
    def _full(self) -> str:
        """What is said of a disk that is full."""
        return _FULL if self._reserve.given_up else _NO_MORE

    def _restart_log(self) -> None:
        with suppress(sqlite3.Error):
            self._store.restart_log()

    def _opened(self, owner: Owner, tell: Callable[[str], None]) -> Opened:
        """Raises JournalError."""
        try:
            try:
                return opened(self.path, owner, tell, self._clock.time())
            except (sqlite3.Error, OSError):
                # SQLite needs some room of its own.
                self._reserve.give_up()
                return opened(self.path, owner, tell, self._clock.time())
        except (sqlite3.Error, OSError) as error:
            raise _failure(self.path, error) from None


def _number(path: Path) -> int:
    """What the file system calls a file, 0 for none."""
    try:
        return path.stat().st_ino
    except OSError:
        return 0


def _locked(path: Path) -> Lock:
    try:
        private_folder(path.parent)
    except OutputFileError as error:
        raise JournalError(str(path), error.reason) from None
    return Lock(path)


def _failure(path: Path, error: sqlite3.Error | OSError) -> JournalError:
    if isinstance(error, OSError):
        return JournalError(str(path), (error.strerror or str(error)).lower())
    reason, advice = _REASONS.get(primary(error), (str(error), "start this host again: it says what is left"))
    return JournalError(str(path), reason, advice)

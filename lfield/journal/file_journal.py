"""The journal of a host on disk: journal writes are committed by a thread, never in the event loop."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

from lfield.clock import Clock
from lfield.errors import JournalError, OutputFileError
from lfield.journal.group_commit import JournalBase
from lfield.journal.journal import Change
from lfield.journal.journal_loader import JournalOwner, LoadedJournal, open_journal, primary_code
from lfield.journal.journal_lock import JournalLock
from lfield.journal.records import CoordinatorRecord, PendingCallRecord, RecordKey, encode_record, key_of
from lfield.journal.space_reservation import SpaceReservation
from lfield.journal.store import Store
from lfield.journal.wal import clear_dirty_flag, set_dirty_flag, wal_file
from lfield.text.secure_files import private_folder

_DISK_FULL = "its disk is full: it writes into the space that was kept in advance"
_DISK_NEARLY_FULL = "its disk has room for what is here, and for no more"
#: Bytes reserved for the result of a pending asynchronous call.
RESULT = 1024
_FREE_SPACE = "make room on that disk"

#: The reason why writing failed, and the remedy, by SQLite's result codes.
_REASONS = {
    sqlite3.SQLITE_FULL: ("no space is left on its disk", _FREE_SPACE),
    sqlite3.SQLITE_READONLY: ("its disk is read-only", "mount it for writing, or name another --state"),
    sqlite3.SQLITE_IOERR: ("its disk fails", "see the kernel log (dmesg)"),
    sqlite3.SQLITE_CANTOPEN: ("it cannot be opened", "check the permissions, or name another --state"),
    sqlite3.SQLITE_PERM: ("permission denied", "check the permissions, or name another --state"),
    sqlite3.SQLITE_BUSY: ("another program writes to it", "end that program"),
}


class FileJournal(JournalBase):
    """See `Journal`. Open it before the loop starts, and close it after the loop has ended.

    `path` is the path of `journal_file`; `report` receives a sentence for every damage found. Raises
    JournalError, JournalInUse and ForeignJournal.
    """

    def __init__(self, path: Path, owner: JournalOwner, report: Callable[[str], None], clock: Clock) -> None:
        self.path, self._clock = path, clock
        self.problem = ""
        self._reservation = SpaceReservation(path.with_name("host.reserve"))
        self._lock = _locked(path)
        try:
            self._store, head, records = self._load(owner, report)
        except BaseException:
            self._lock.release()
            raise
        self.identity = head.identity
        super().__init__(records, self._commit_in_thread, clock)
        self._inode = path.stat().st_ino
        #: The inode of the write-ahead log, 0 before there is one.
        self._log = 0
        #: Bytes of each stored copy, and of each pending result.
        self._sizes: dict[RecordKey, int] = {}
        self._update_sizes([Change(self._read)])
        self.problem = self._reserve_space()
        self._thread = ThreadPoolExecutor(1, "journal")
        self._closed = self._reopen = False

    # --- the journal ----------------------------------------------------------------------------------

    def close(self) -> None:
        """See `Journal`."""
        if self._closed:
            return
        self._closed = True
        self._thread.shutdown()
        clear_dirty_flag(self.path)
        with suppress(sqlite3.Error):
            self._store.close()
        self._lock.release()

    # --- in the commit thread -------------------------------------------------------------------------

    async def _commit_in_thread(self, changes: Sequence[Change]) -> None:
        if self._closed:
            raise JournalError(str(self.path), "it is closed")
        await asyncio.get_running_loop().run_in_executor(self._thread, self._commit, changes)

    def _commit(self, changes: Sequence[Change]) -> None:
        """Commit all changes, or none. Raises JournalError."""
        try:
            self._check_file_present()
            problem = self._reserve_space()
            try:
                self._write(changes)
            except sqlite3.Error as error:
                if primary_code(error) not in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR):
                    raise
                self._reservation.release()
                problem = self._full
                # The log already has space for this commit.
                self._restart_log()
                self._write(changes)
        except (sqlite3.Error, OSError) as error:
            self._reopen = not (
                isinstance(error, sqlite3.Error) and primary_code(error) == sqlite3.SQLITE_FULL
            )
            failure = _failure(self.path, error)
            self.problem = failure.reason
            raise failure from None
        self._update_sizes(changes)
        self._set_dirty_flag()
        self.problem = problem or self._reserve_space()
        if self.problem:
            # The log must not grow into the remaining space.
            self._restart_log()

    def _write(self, changes: Sequence[Change]) -> None:
        now = self._clock.time()
        groups = [([encode_record(record, now) for record in records], keys) for records, keys in changes]
        if any(records or keys for records, keys in groups):
            self._store.commit(groups)
        else:
            self._store.probe_write()

    def _check_file_present(self) -> None:
        """Check that the file was not deleted, because its data would be lost. Raises OSError and
        sqlite3.Error.
        """
        if self.path.stat().st_ino != self._inode:
            raise FileNotFoundError(0, "another file was put in its place")
        if self._reopen or (self._log and _number(wal_file(self.path)) != self._log):
            # SQLite would write a deleted log into the database on close.
            clear_dirty_flag(self.path)
            with suppress(sqlite3.Error):
                self._store.close()
            self._store = Store.open(self.path)
            self._reopen = False
            self._log = 0

    def _set_dirty_flag(self) -> None:
        if not self._log:
            self._log = _number(wal_file(self.path))
            set_dirty_flag(self.path)

    # --- space ----------------------------------------------------------------------------------------

    def _update_sizes(self, changes: Sequence[Change]) -> None:
        for records, keys in changes:
            for record in records:
                if isinstance(record, CoordinatorRecord) and record.state in ("RUN", "PREPARED"):
                    self._sizes[key_of(record)] = len(record.block)
                elif isinstance(record, PendingCallRecord) and not record.outcome:
                    self._sizes[key_of(record)] = RESULT
                else:
                    self._sizes.pop(key_of(record), None)
            for key in keys:
                self._sizes.pop(key, None)

    def _reserve_space(self) -> str:
        """Reserve disk space; returns the reason of a failure, '' after success."""
        try:
            self._reservation.grow_to(sum(self._sizes.values()))
        except OSError:
            return self._full
        return ""

    @property
    def _full(self) -> str:
        """The message about a full disk."""
        return _DISK_FULL if self._reservation.is_released else _DISK_NEARLY_FULL

    def _restart_log(self) -> None:
        with suppress(sqlite3.Error):
            self._store.restart_log()

    def _load(self, owner: JournalOwner, report: Callable[[str], None]) -> LoadedJournal:
        """Load the journal. Raises JournalError."""
        try:
            try:
                return open_journal(self.path, owner, report, self._clock.time())
            except (sqlite3.Error, OSError):
                # SQLite needs space for its own files.
                self._reservation.release()
                return open_journal(self.path, owner, report, self._clock.time())
        except (sqlite3.Error, OSError) as error:
            raise _failure(self.path, error) from None


def _number(path: Path) -> int:
    """The inode of a file, 0 for none."""
    try:
        return path.stat().st_ino
    except OSError:
        return 0


def _locked(path: Path) -> JournalLock:
    try:
        private_folder(path.parent)
    except OutputFileError as error:
        raise JournalError(str(path), error.reason) from None
    return JournalLock(path)


def _failure(path: Path, error: sqlite3.Error | OSError) -> JournalError:
    if isinstance(error, OSError):
        return JournalError(str(path), (error.strerror or str(error)).lower())
    reason, advice = _REASONS.get(
        primary_code(error), (str(error), "start this host again: it reports what could be read")
    )
    return JournalError(str(path), reason, advice)

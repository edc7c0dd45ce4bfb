"""The SQLite database of a journal; its write-ahead log is on disk when a commit returns.

Calls block. One thread at a time uses a `Store`.
"""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import msgspec
from msgspec import Struct

from lfield.journal.records import JournalEntry, RecordKey
from lfield.wire.fields import Count

#: The version of the tables. A newer version is refused, older ones are read.
FORMAT = 1
#: "LFJN", SQLite's application id.
APPLICATION = 0x4C464A4E
#: Pages of 4 KiB after which the log is checkpointed: the number is small, since the log must fit the
#: reserved space.
_LOG_PAGES = 256
#: The size to which the log is truncated.
_LOG_BYTES = 1 << 20

_ENTRY = "kind TEXT, name TEXT, number INTEGER, kept REAL, version INTEGER, body BLOB, sum INTEGER"
_TABLES = (
    f"CREATE TABLE pages ({_ENTRY}, PRIMARY KEY (kind, name, number))",
    f"CREATE TABLE damaged ({_ENTRY}, why TEXT, found REAL)",
    "CREATE TABLE head (body BLOB, sum INTEGER)",
)
_COLUMNS = "kind, name, number, kept, version, body, sum"
_WRITE = (
    f"INSERT INTO pages ({_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?) ON CONFLICT (kind, name, number) "
    "DO UPDATE SET kept = excluded.kept, version = excluded.version, body = excluded.body, sum = excluded.sum"
)
_FORGET = "DELETE FROM pages WHERE kind = ? AND name = ? AND number = ?"
_NOTE_DAMAGE = f"INSERT INTO damaged ({_COLUMNS}, why, found) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)"


class JournalHeader(Struct, frozen=True, forbid_unknown_fields=True):
    """The owner of a journal: its random id, the deployment and host by name, the computer by a hash."""

    identity: Count
    deployment: str
    host: str
    machine: str


class DamagedEntry(NamedTuple):
    """A damaged entry, the reason, and its row id."""

    entry: JournalEntry
    reason: str
    place: int = 0


class BrokenFile(sqlite3.DatabaseError):
    """A database that is damaged in a way that SQLite does not detect. Internal to this package."""


class Store:
    """An open database. All methods raise sqlite3.Error."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    @classmethod
    def open(cls, path: Path) -> Store:
        """Open an existing database for writing."""
        store = cls(_connect(f"{path.resolve().as_uri()}?mode=rw"))
        with store._closed_on_error():
            store._run("PRAGMA synchronous = FULL")
            store._run(f"PRAGMA wal_autocheckpoint = {_LOG_PAGES}")
            store._run(f"PRAGMA journal_size_limit = {_LOG_BYTES}")
        return store

    @classmethod
    def open_read_only(cls, path: Path) -> Store:
        """Open an existing database read-only, also while another process writes to it."""
        return cls(_connect(f"{path.resolve().as_uri()}?mode=ro"))

    @classmethod
    def create(
        cls,
        path: Path,
        head: JournalHeader,
        entries: Iterable[JournalEntry] = (),
        damaged: Sequence[DamagedEntry] = (),
        found: float = 0.0,
    ) -> None:
        """Create a complete database in a new file; it is closed and on disk."""
        with closing(_connect(f"{path.resolve().as_uri()}?mode=rwc")) as connection:
            store = cls(connection)
            store._run("PRAGMA synchronous = FULL")
            store._run(f"PRAGMA application_id = {APPLICATION}")
            store._run(f"PRAGMA user_version = {FORMAT}")
            with store._transaction():
                for table in _TABLES:
                    store._run(table)
                store._write_head(head)
                store._write(entries)
                store._note(damaged, found)
            store._run("PRAGMA journal_mode = WAL")

    # --- reading --------------------------------------------------------------------------------------

    def application_id(self) -> int:
        """The application id in the file."""
        return self._number("PRAGMA application_id")

    def format_version(self) -> int:
        """The version of the tables."""
        return self._number("PRAGMA user_version")

    def fault(self) -> str:
        """The fault that SQLite finds in the file, '' for none."""
        found = str(self._run("PRAGMA quick_check(1)").fetchone()[0])
        return "" if found == "ok" else found.splitlines()[-1]

    def head(self) -> JournalHeader | None:
        """The owner; None if the header is damaged."""
        row = self._run("SELECT body, sum FROM head").fetchone()
        with suppress(msgspec.MsgspecError, UnicodeDecodeError, TypeError):
            if row and zlib.crc32(row[0]) == row[1]:
                return msgspec.json.decode(row[0], type=JournalHeader)
        return None

    def entries(self, *, backwards: bool = False) -> Iterator[tuple[int, JournalEntry]]:
        """All entries with their row ids, in ascending or descending order."""
        order = "DESC" if backwards else "ASC"
        with _readable_errors():
            for row in self._run(f"SELECT rowid, {_COLUMNS} FROM pages ORDER BY rowid {order}"):
                yield row[0], JournalEntry(RecordKey(*row[1:4]), *row[4:])

    def damaged(self) -> list[DamagedEntry]:
        """The entries that were moved aside."""
        with _readable_errors():
            rows = self._run(f"SELECT {_COLUMNS}, why FROM damaged ORDER BY rowid").fetchall()
        return [DamagedEntry(JournalEntry(RecordKey(*row[:3]), *row[3:7]), row[7]) for row in rows]

    # --- writing --------------------------------------------------------------------------------------

    def commit(self, groups: Sequence[tuple[Sequence[JournalEntry], Iterable[RecordKey]]]) -> None:
        """Write entries and remove keys, in this order: all are on disk, or the database has not changed."""
        with self._transaction():
            for entries, keys in groups:
                self._write(entries)
                self._connection.executemany(_FORGET, keys)

    def move_aside(self, damaged: Sequence[DamagedEntry], head: JournalHeader, found: float) -> None:
        """Remove damaged entries from the records, and give the journal a new id."""
        with self._transaction():
            self._note(damaged, found)
            places = [(damage.place,) for damage in damaged]
            self._connection.executemany("DELETE FROM pages WHERE rowid = ?", places)
            self._run("DELETE FROM head")
            self._write_head(head)

    def probe_write(self) -> None:
        """Write without a change, to test the disk."""
        with self._transaction():
            self._run("UPDATE head SET sum = sum")

    def restart_log(self) -> None:
        """Checkpoint the log, so that the next commit writes to its beginning."""
        self._run("PRAGMA wal_checkpoint(RESTART)")

    def close(self) -> None:
        """Checkpoint the log, and close the database."""
        self._connection.close()

    # --- SQL ------------------------------------------------------------------------------------------

    def _write(self, entries: Iterable[JournalEntry]) -> None:
        self._connection.executemany(_WRITE, ((*entry.key, *entry[1:]) for entry in entries))

    def _note(self, damaged: Iterable[DamagedEntry], found: float) -> None:
        rows = ((*damage.entry.key, *damage.entry[1:], damage.reason, found) for damage in damaged)
        self._connection.executemany(_NOTE_DAMAGE, rows)

    def _write_head(self, head: JournalHeader) -> None:
        body = msgspec.json.encode(head)
        self._connection.execute("INSERT INTO head VALUES (?, ?)", (body, zlib.crc32(body)))

    def _run(self, statement: str) -> sqlite3.Cursor:
        with _readable_errors():
            return self._connection.execute(statement)

    def _number(self, statement: str) -> int:
        return int(self._run(statement).fetchone()[0])

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._run("BEGIN IMMEDIATE")
        try:
            with _readable_errors():
                yield
            self._run("COMMIT")
        except BaseException:
            with suppress(sqlite3.Error):
                self._run("ROLLBACK")
            raise

    @contextmanager
    def _closed_on_error(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            self._connection.close()
            raise


@contextmanager
def _readable_errors() -> Iterator[None]:
    """Convert Python's decoding errors: SQLite's error messages quote damaged names."""
    try:
        yield
    except UnicodeDecodeError:
        raise BrokenFile("its tables have names that cannot be read") from None


def _connect(name: str) -> sqlite3.Connection:
    # The commit thread is not the thread that opens the database; the two never use it at the same time.
    connection = sqlite3.connect(name, uri=True, isolation_level=None, check_same_thread=False, timeout=1.0)
    connection.text_factory = lambda data: data.decode(errors="replace")
    return connection

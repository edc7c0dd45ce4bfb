"""The database of a journal: SQLite, whose write-ahead log is on the disk when a commit returns.

Nothing here runs on a loop. One thread at a time uses a `Store`.
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

from lfield.journal.pages import Entry, Key
from lfield.wire.fields import Count

#: The version of the tables. A newer one is refused, all older ones are read.
FORMAT = 1
#: "LFJN", where SQLite has room for whose a database is.
APPLICATION = 0x4C464A4E
#: Pages of 4 KiB after which the log is worked into the database: small, since it must fit the reserve.
_LOG_PAGES = 256
#: Bytes that stay of the log when it was larger.
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


class Head(Struct, frozen=True, forbid_unknown_fields=True):
    """Whose a journal is: its random identity, the deployment and host by name, the computer by a hash."""

    identity: Count
    deployment: str
    host: str
    machine: str


class Damaged(NamedTuple):
    """An entry that cannot be believed, why, and at which place it lies among the pages."""

    entry: Entry
    why: str
    place: int = 0


class BrokenFile(sqlite3.DatabaseError):
    """A database that is damaged in a way that SQLite has no name for. It never leaves this room."""


class Store:
    """An open database. All methods raise sqlite3.Error."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    @classmethod
    def open(cls, path: Path) -> Store:
        """The database that is there, for writing."""
        store = cls(_connect(f"{path.resolve().as_uri()}?mode=rw"))
        with store._closed_on_error():
            store._run("PRAGMA synchronous = FULL")
            store._run(f"PRAGMA wal_autocheckpoint = {_LOG_PAGES}")
            store._run(f"PRAGMA journal_size_limit = {_LOG_BYTES}")
        return store

    @classmethod
    def look_at(cls, path: Path) -> Store:
        """The database that is there, for reading only, also while somebody writes to it."""
        return cls(_connect(f"{path.resolve().as_uri()}?mode=ro"))

    @classmethod
    def create(
        cls,
        path: Path,
        head: Head,
        entries: Iterable[Entry] = (),
        damaged: Sequence[Damaged] = (),
        found: float = 0.0,
    ) -> None:
        """A whole database in a file that is not there yet; it is closed, and on the disk."""
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

    def application(self) -> int:
        """Whose database it says that it is."""
        return self._number("PRAGMA application_id")

    def version(self) -> int:
        """The version of its tables."""
        return self._number("PRAGMA user_version")

    def fault(self) -> str:
        """What SQLite finds wrong with the file, '' for nothing."""
        found = str(self._run("PRAGMA quick_check(1)").fetchone()[0])
        return "" if found == "ok" else found.splitlines()[-1]

    def head(self) -> Head | None:
        """Whose it is; None when that is damaged."""
        row = self._run("SELECT body, sum FROM head").fetchone()
        with suppress(msgspec.MsgspecError, UnicodeDecodeError, TypeError):
            if row and zlib.crc32(row[0]) == row[1]:
                return msgspec.json.decode(row[0], type=Head)
        return None

    def entries(self, *, backwards: bool = False) -> Iterator[tuple[int, Entry]]:
        """All pages with their places, in the order of these or the other way round."""
        order = "DESC" if backwards else "ASC"
        with _told():
            for row in self._run(f"SELECT rowid, {_COLUMNS} FROM pages ORDER BY rowid {order}"):
                yield row[0], Entry(Key(*row[1:4]), *row[4:])

    def damaged(self) -> list[Damaged]:
        """What was moved aside."""
        with _told():
            rows = self._run(f"SELECT {_COLUMNS}, why FROM damaged ORDER BY rowid").fetchall()
        return [Damaged(Entry(Key(*row[:3]), *row[3:7]), row[7]) for row in rows]

    # --- writing --------------------------------------------------------------------------------------

    def commit(self, groups: Sequence[tuple[Sequence[Entry], Iterable[Key]]]) -> None:
        """Entries to write and keys to remove, in this order: all are on the disk, or nothing has changed."""
        with self._transaction():
            for entries, keys in groups:
                self._write(entries)
                self._connection.executemany(_FORGET, keys)

    def move_aside(self, damaged: Sequence[Damaged], head: Head, found: float) -> None:
        """Take pages out that cannot be believed, and be another memory from now on."""
        with self._transaction():
            self._note(damaged, found)
            places = [(one.place,) for one in damaged]
            self._connection.executemany("DELETE FROM pages WHERE rowid = ?", places)
            self._run("DELETE FROM head")
            self._write_head(head)

    def try_out(self) -> None:
        """Write something that changes nothing."""
        with self._transaction():
            self._run("UPDATE head SET sum = sum")

    def restart_log(self) -> None:
        """Work the log into the database, so that the next commit writes to its beginning."""
        self._run("PRAGMA wal_checkpoint(RESTART)")

    def close(self) -> None:
        """Work the log into the database, and let go of both."""
        self._connection.close()

    # --- SQL ------------------------------------------------------------------------------------------

    def _write(self, entries: Iterable[Entry]) -> None:
        self._connection.executemany(_WRITE, ((*entry.key, *entry[1:]) for entry in entries))

    def _note(self, damaged: Iterable[Damaged], found: float) -> None:
        rows = ((*one.entry.key, *one.entry[1:], one.why, found) for one in damaged)
        self._connection.executemany(_NOTE_DAMAGE, rows)

    def _write_head(self, head: Head) -> None:
        body = msgspec.json.encode(head)
        self._connection.execute("INSERT INTO head VALUES (?, ?)", (body, zlib.crc32(body)))

    def _run(self, statement: str) -> sqlite3.Cursor:
        with _told():
            return self._connection.execute(statement)

    def _number(self, statement: str) -> int:
        return int(self._run(statement).fetchone()[0])

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._run("BEGIN IMMEDIATE")
        try:
            with _told():
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
def _told() -> Iterator[None]:
    """SQLite quotes what is damaged, and Python cannot read that."""
    try:
        yield
    except UnicodeDecodeError:
        raise BrokenFile("its tables have names that cannot be read") from None


def _connect(name: str) -> sqlite3.Connection:
    # The thread of the commits is another one than that which opens it; they never meet.
    connection = sqlite3.connect(name, uri=True, isolation_level=None, check_same_thread=False, timeout=1.0)
    connection.text_factory = lambda data: data.decode(errors="replace")
    return connection

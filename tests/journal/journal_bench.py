"""The disks of the journal tests: a real one, and a simulated one."""

from __future__ import annotations

import asyncio
import random
import shutil
import sqlite3
from collections.abc import Coroutine
from contextlib import closing
from pathlib import Path
from typing import Any, Protocol, TypeVar

from lfield.clock import Clock, ManualClock
from lfield.journal.file_journal import FileJournal
from lfield.journal.journal import Journal
from lfield.journal.journal_loader import JournalOwner
from lfield.journal.records import RecordKey
from lfield.simulate.computers.event_queue import EventQueue
from lfield.simulate.computers.process_loop import ProcessLoop
from lfield.simulate.computers.simulated_machine import SimulatedMachine
from lfield.simulate.journal_disk import JournalDisk

T = TypeVar("T")
OWNER = JournalOwner("harvest", "barn", "this computer")


class Bench(Protocol):
    """A disk, and successive processes that open its journal."""

    clock: Clock
    reports: list[str]

    def open(self) -> Journal:
        """Start a process; the previous process was killed, unless it closed the journal."""

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        """Run work in the process."""

    def fill(self, full: bool) -> None:
        """Fill the disk and its reserve (no space for a large record), or free the space again."""

    def damage(self, key: RecordKey) -> None:
        """Damage a record, while no process has the journal open."""


class FileBench:
    """A folder for each process: `open` copies the files of the killed process as they are at that moment."""

    def __init__(self, folder: Path) -> None:
        self.clock, self.reports = ManualClock(), list[str]()
        self._folder, self._process_number = folder, 0
        self.journal: FileJournal | None = None

    @property
    def path(self) -> Path:
        return self._folder / str(self._process_number) / "host.journal"

    def open(self, owner: JournalOwner = OWNER) -> FileJournal:
        killed, old_folder = self.journal, self.path.parent
        if killed is not None:
            self._process_number += 1
            shutil.copytree(old_folder, self.path.parent)
            killed.close()
        self.journal = FileJournal(self.path, owner, self.reports.append, self.clock)
        return self.journal

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        return asyncio.run(work)

    def fill(self, full: bool) -> None:
        assert self.journal is not None
        connection = self.journal._store._connection
        connection.execute(f"PRAGMA max_page_count = {1 if full else 1 << 20}")

    def damage(self, key: RecordKey) -> None:
        self.sql("UPDATE pages SET sum = sum + 1 WHERE kind = ? AND name = ? AND number = ?", *key)

    def sql(self, statement: str, *values: object) -> None:
        with closing(sqlite3.connect(self.path)) as connection, connection:
            connection.execute(statement, values)

    def end(self) -> None:
        if self.journal is not None:
            self.journal.close()


class SimulatedBench:
    """A simulated disk, and simulated processes: each has its own event loop, and is killed with it."""

    def __init__(self) -> None:
        self.timeline = EventQueue()
        self.machine = SimulatedMachine("barn", self.timeline, random.Random(1))
        self.clock, self.reports = self.machine.clock, list[str]()
        self.disk = JournalDisk(random.Random(2), sync=0.05)
        self.disk.reserve = 0
        self.loop = ProcessLoop(self.machine)

    def open(self) -> Journal:
        self.loop.die()
        self.loop.close()
        self.loop = ProcessLoop(self.machine)
        return self.disk.open(self.clock, self.reports.append)

    def run(self, work: Coroutine[Any, Any, T]) -> T:
        tasks: list[asyncio.Task[T]] = []
        self.loop.enter(lambda: tasks.append(self.loop.create_task(work)))
        self.timeline.run(30.0)
        return tasks[0].result()

    def fill(self, full: bool) -> None:
        self.disk.full, self.disk.reserve = full, 0

    def damage(self, key: RecordKey) -> None:
        self.disk.damage(key)

    def end(self) -> None:
        self.loop.close()

"""Writes records until the process is killed: `python journal_writer.py FOLDER`.

Prints a line for each durable record.
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from lfield.clock import SystemClock
from lfield.journal.file_journal import FileJournal
from lfield.journal.journal_loader import JournalOwner
from lfield.journal.records import CoordinatorRecord, StartCounter


async def write(folder: Path) -> None:
    owner = JournalOwner("harvest", "barn", "this computer")
    journal = FileJournal(folder / "host.journal", owner, print, SystemClock())
    (count,) = [page.count for page in journal.records() if isinstance(page, StartCounter)] or [0]
    while True:
        count += 1
        block = count.to_bytes(8, "big") * 1000
        await journal.persist(
            [StartCounter(count), CoordinatorRecord("scout", 1, "RUN", sequence=count, block=block)]
        )
        print(count, flush=True)


if __name__ == "__main__":
    asyncio.run(write(Path(sys.argv[1])))

"""Keeps pages until it is killed: `python journal_writer.py FOLDER`; says which are kept, a line for each."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from lfield.clock import SystemClock
from lfield.journal.file import FileJournal
from lfield.journal.opening import Owner
from lfield.journal.pages import CopyPage, Starts


async def write(folder: Path) -> None:
    owner = Owner("harvest", "barn", "this computer")
    journal = FileJournal(folder / "host.journal", owner, print, SystemClock())
    (count,) = [page.count for page in journal.pages() if isinstance(page, Starts)] or [0]
    while True:
        count += 1
        block = count.to_bytes(8, "big") * 1000
        await journal.keep([Starts(count), CopyPage("scout", 1, "RUN", sequence=count, block=block)])
        print(count, flush=True)


if __name__ == "__main__":
    asyncio.run(write(Path(sys.argv[1])))

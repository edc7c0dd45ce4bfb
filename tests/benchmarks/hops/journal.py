"""The cost of writing a page to the disk: a hop has two commits, and each of them writes one page.

A page of the given size is overwritten repeatedly, like the page of a coordinator; the loop waits for each
commit here, but not in a host. Pages that are stored at the same time share one commit. The reference is
the minimum work of a disk: the same number of bytes is overwritten in a file and synced.
"""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

from harness.checkout import Checkout
from harness.figure import Figure, Opener
from harness.processes import Processes
from harness.samples import Contender, timed

from lfield.clock import SystemClock
from lfield.journal.file_journal import FileJournal
from lfield.journal.journal_loader import JournalOwner
from lfield.journal.records import CoordinatorRecord

SIZES = (64, 4 << 10, 64 << 10)
COMMITS, AT_ONCE = 40, 16


def keeping(at_once: int) -> Opener:
    """Seconds for each page when several are stored at the same time."""

    def opener(checkout: Checkout, processes: Processes) -> Contender:
        return lambda: asyncio.run(_keep(processes.folder(), at_once))

    return opener


async def _keep(folder: Path, at_once: int) -> dict[str, list[float]]:
    clock = SystemClock()
    journal = FileJournal(folder / "host.journal", JournalOwner("bench", "here", ""), print, clock)
    durations: dict[str, list[float]] = {}
    for size in SIZES:
        block = bytes(size)
        for count in range(COMMITS):
            pages = [CoordinatorRecord(f"agent{n}", 1, "RUN", count, block=block) for n in range(at_once)]
            start = clock.monotonic()
            await asyncio.gather(*(journal.persist([page]) for page in pages))
            durations.setdefault(_case(size), []).append((clock.monotonic() - start) / at_once)
    journal.close()
    return durations


def syncing(checkout: Checkout, processes: Processes) -> Contender:
    """Seconds of a write with fdatasync."""
    descriptor = os.open(processes.folder() / "bytes", os.O_RDWR | os.O_CREAT)
    os.pwrite(descriptor, bytes(max(SIZES)), 0)
    os.fsync(descriptor)

    def write(size: int) -> None:
        os.pwrite(descriptor, os.urandom(size), 0)
        os.fdatasync(descriptor)

    return lambda: {_case(size): [timed(lambda s=size: write(s)) for _ in range(COMMITS)] for size in SIZES}


def _case(size: int) -> str:
    return f"{size} B"


FIGURE = Figure(
    "A page in the journal, by the size of its block; ratio to a write and a sync",
    {"lfield: one": keeping(1), f"lfield: each of {AT_ONCE}": keeping(AT_ONCE), "write, fdatasync": syncing},
    base=("write, fdatasync",),
    rounds=8,
    sizes={_case(size): size for size in SIZES},
    notes=(f"rounds of {COMMITS} commits, on the disk of the temporary folder",),
)

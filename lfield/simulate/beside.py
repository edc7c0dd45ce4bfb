"""What stands beside a host on its simulated computer: its guards, which are real, and its disk."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Collection, Sequence

from lfield.driver.plugin import load_plugin
from lfield.errors import JournalError
from lfield.guard.process import Shell
from lfield.journal.pages import Key, Page, key_of
from lfield.simulate.computers.computer import Input, Process

#: Where the driver of simulated hardware is.
REFERENCE = "lfield.simulate.hardware:PLUGIN"
#: Seconds until something written is on a disk.
SYNC = 0.002


def guard(process: Process, output: asyncio.WriteTransport) -> Input:
    """What `python -m lfield.guard.process` does, around the pipes of a simulation."""
    shell = Shell(load_plugin(REFERENCE), output, process.loop.clock)

    async def serve() -> None:
        status = await shell.exit
        await shell.close()
        process.exit(status)

    process.loop.create_task(serve())

    def came(data: bytes | None) -> None:
        if data is None:
            shell.connection_lost(None)
        else:
            shell.data_received(data)

    return came


class Disk:
    """The disk of a host, which outlives its processes; each of them opens the journal on it."""

    def __init__(self, dice: random.Random) -> None:
        self._dice = dice
        #: Whether it takes nothing any more.
        self.full = False
        #: Whether nothing was ever kept on it, as whoever set the team up knows.
        self.new = True
        self._empty()

    def _empty(self) -> None:
        self.identity = self._dice.getrandbits(62) + 1
        self.kept: dict[Key, Page] = {}

    def replace(self) -> None:
        """Another disk, empty, of which nobody knows what was on the one before."""
        self._empty()
        self.new = False

    def open(self) -> DiskJournal:
        """The journal, for a new process."""
        return DiskJournal(self)


class DiskJournal:
    """A `Journal`. What is not on the disk yet when its process ends never gets there."""

    trouble = ""

    def __init__(self, disk: Disk) -> None:
        self._disk, self.identity = disk, disk.identity

    def pages(self) -> list[Page]:
        """See `Journal`."""
        return list(self._disk.kept.values())

    async def keep(self, pages: Sequence[Page]) -> None:
        """See `Journal`."""
        await asyncio.sleep(SYNC)
        if self._disk.full:
            raise JournalError("host.journal", "no space is left on its disk")
        self._disk.kept.update((key_of(page), page) for page in pages)

    async def forget(self, keys: Collection[Key]) -> None:
        """See `Journal`."""
        for key in keys:
            self._disk.kept.pop(key, None)

    def commits_last_minute(self, now: float) -> int:
        """See `Journal`."""
        return 0

    def close(self) -> None:
        """See `Journal`."""

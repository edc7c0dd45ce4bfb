"""What stands beside a host on its simulated computer: its guards, which are real, and its disk."""

from __future__ import annotations

import asyncio

from lfield.driver.plugin import load_plugin
from lfield.errors import OutputFileError
from lfield.guard.shell import Shell
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
    """The record of a host's starts. What is not on it yet when its process ends never gets there."""

    def __init__(self) -> None:
        #: Whether nothing was ever kept on it, as whoever set the team up knows.
        self.new = True
        #: Whether it takes nothing any more.
        self.full = False
        self._starts: int | None = None

    def replace(self) -> None:
        """Another disk, empty, of which nobody knows what was on the one before."""
        self._starts, self.new = None, False

    def read(self) -> int | None:
        """The last start; None for none."""
        return self._starts

    async def write(self, generation: int) -> None:
        """Keep a start. Raises OutputFileError when the disk is full."""
        await asyncio.sleep(SYNC)
        if self.full:
            raise OutputFileError("starts.json", "No space left on device")
        self._starts, self.new = generation, False

"""What stands beside a host on its simulated computer: its guards, which are real."""

from __future__ import annotations

import asyncio

from lfield.driver.plugin import load_plugin
from lfield.guard.shell import Shell
from lfield.simulate.computers.computer import Input, Process

#: Where the driver of simulated hardware is.
REFERENCE = "lfield.simulate.hardware:PLUGIN"


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

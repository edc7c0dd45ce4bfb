"""The guard process of one bus: `python -m lfield.guard.process package:PLUGIN`.

Frames come in on stdin, go out on stdout; the log is stderr. It imports the driver and never the machine, so
a busy program cannot make its timers late. When stdin ends the devices are made safe and the process ends.
Signals do not end it: while its host lives only the host knows when the devices may be left, and when it is
gone only the guard does.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Sequence

from lfield import exits, loop
from lfield.clock import SystemClock
from lfield.driver.plugin import Plugin, load_plugin
from lfield.errors import LfieldError
from lfield.guard.shell import Shell
from lfield.text.outlet import never_waiting


async def serve(plugin: Plugin, input_fd: int, output_fd: int) -> int:
    """Guard one bus until the host says stop or is gone; the exit status."""
    running = asyncio.get_running_loop()
    output, _ = await running.connect_write_pipe(asyncio.BaseProtocol, os.fdopen(output_fd, "wb", 0))
    # Only now: a vendor library that takes its time to load must not delay the guards of other buses.
    shell = Shell(plugin, output, SystemClock(), loop.be_prompt)
    source, _ = await running.connect_read_pipe(lambda: shell, os.fdopen(input_fd, "rb", 0))
    # A service manager signals every process of its group at once. A guard that obeyed would take its
    # station's heartbeats away from a vehicle that lands.
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        running.add_signal_handler(number, shell.signalled, number)
    try:
        return await shell.exit
    finally:
        await shell.close()
        source.close()
        output.close()


def main(arguments: Sequence[str]) -> int:
    """Run the guard of the plugin `package:PLUGIN`."""
    if len(arguments) != 1:
        print("usage: python -m lfield.guard.process package:PLUGIN", file=sys.stderr)
        return exits.USAGE
    # A vendor library that prints must not end up in the middle of a frame, nor wait for who reads the log.
    output_fd = os.dup(1)
    os.dup2(2, 1)
    with never_waiting():
        try:
            plugin = load_plugin(arguments[0])
            return loop.run(serve(plugin, os.dup(0), output_fd))
        except LfieldError as error:
            print(error, file=sys.stderr)
            return error.exit_status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

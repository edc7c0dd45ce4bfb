"""The guard process of one bus: `python -m lfield.guard.process package:PLUGIN`.

Frames come in on stdin, go out on stdout; the log is stderr. It imports the driver and never the machine, so
a busy program cannot make its timers late. Its first message says which devices it guards: before any line of
the driver is loaded, and before there is a second thread, the process gives away all that these do not need
(`reach`, `confine`). When stdin ends the devices are made safe and the process ends.
Signals do not end it: while its host lives only the host knows when the devices may be left, and when it is
gone only the guard does.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress

from lfield import exits, loop
from lfield.clock import SystemClock
from lfield.driver.plugin import Plugin, load_plugin
from lfield.errors import LfieldError, WireError
from lfield.guard.confine import confine
from lfield.guard.messages import MAX_PAYLOAD, MessageReader, Open
from lfield.guard.reach import Reach, reach
from lfield.guard.shell import Shell
from lfield.text.outlet import never_waiting
from lfield.text.private import temporary_folder
from lfield.wire.framing import size_of


async def serve(plugin: Plugin, first: bytes, input_fd: int, output_fd: int) -> int:
    """Guard one bus until the host says stop or is gone; the exit status. `first` was read of it already."""
    running = asyncio.get_running_loop()
    output, _ = await running.connect_write_pipe(asyncio.BaseProtocol, os.fdopen(output_fd, "wb", 0))
    # Only now: a vendor library that takes its time to load must not delay the guards of other buses.
    shell = Shell(plugin, output, SystemClock(), loop.be_prompt)
    shell.data_received(first)
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


def first_message(descriptor: int) -> bytes:
    """The first frame that the host sends, as far as it comes; b"" when there is none."""
    data = b""
    while len(data) < (wanted := size_of(data, MAX_PAYLOAD)) and (
        more := os.read(descriptor, wanted - len(data))
    ):
        data += more
    return data


def keep_to(first: bytes) -> None:
    """Touch nothing any more but what the devices of an Open need, as far as the kernel lets it."""
    with suppress(WireError):
        for message in MessageReader().feed(first):
            if isinstance(message, Open):
                code = {*sys.path, sys.prefix, sys.base_prefix, *_packages()}
                needed = reach(
                    message.devices, message.driver, filter(os.path.isabs, code), str(temporary_folder())
                )
                _confine(needed)


def _confine(needed: Reach) -> None:
    try:
        confine(needed)
    except OSError as error:
        print(f"a guard keeps all rights of its user: {error.strerror}", file=sys.stderr)


def _packages() -> Iterator[str]:
    """Where modules come from that were found otherwise than by the path, as those of an editable install."""
    for finder in sys.meta_path:
        mapping = getattr(sys.modules.get(getattr(finder, "__module__", "")), "MAPPING", {})
        yield from map(str, mapping.values() if isinstance(mapping, dict) else ())


def main(arguments: Sequence[str]) -> int:
    """Run the guard of the plugin `package:PLUGIN`."""
    if len(arguments) != 1:
        print("usage: python -m lfield.guard.process package:PLUGIN", file=sys.stderr)
        return exits.USAGE
    # A vendor library that prints must not end up in the middle of a frame, nor wait for who reads the log.
    output_fd = os.dup(1)
    os.dup2(2, 1)
    keep_to(first := first_message(0))
    with never_waiting():
        try:
            plugin = load_plugin(arguments[0])
            return loop.run(serve(plugin, first, os.dup(0), output_fd))
        except LfieldError as error:
            print(error, file=sys.stderr)
            return error.exit_status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""The guard process of one bus: `python -m lfield.guard.process package:PLUGIN`.

Frames come in on stdin and go out on stdout; the log is stderr. The process imports the driver but never the
VM, so a busy program cannot delay its timers. The first message lists its devices: before the driver is
imported and before a second thread exists, the process drops all rights that the devices do not need
(`policy_for`, `apply_sandbox`). When stdin ends, the devices are made safe and the process ends. Signals do
not end it: while its host lives, only the host decides when the process may leave its devices; afterwards,
the guard decides.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress

from lfield import event_loop, exit_status
from lfield.clock import SystemClock
from lfield.driver.plugin import Plugin, load_plugin
from lfield.errors import LfieldError, WireError
from lfield.guard.messages import MAX_PAYLOAD, MessageReader, OpenDevices
from lfield.guard.sandbox import apply_sandbox
from lfield.guard.sandbox_policy import SandboxPolicy, policy_for
from lfield.guard.shell import Shell
from lfield.text.nonblocking_output import nonblocking_output
from lfield.text.secure_files import temporary_dir
from lfield.wire.framing import size_of


async def serve(plugin: Plugin, first: bytes, input_fd: int, output_fd: int) -> int:
    """Guards one bus until the host stops it or ends; returns the exit status. `first` was already read."""
    loop = asyncio.get_running_loop()
    output, _ = await loop.connect_write_pipe(asyncio.BaseProtocol, os.fdopen(output_fd, "wb", 0))
    # Real-time priority starts after the import of the driver: a vendor library that loads slowly must not
    # delay the guards of other buses.
    shell = Shell(plugin, output, SystemClock(), event_loop.raise_timer_priority)
    shell.data_received(first)
    source, _ = await loop.connect_read_pipe(lambda: shell, os.fdopen(input_fd, "rb", 0))
    # A service manager signals every process of its group at once. A guard that ended then would stop its
    # heartbeats to a vehicle that is still landing.
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        loop.add_signal_handler(number, shell.on_signal, number)
    try:
        return await shell.exit
    finally:
        await shell.close()
        source.close()
        output.close()


def first_message(descriptor: int) -> bytes:
    """The first frame of the host, or its part that arrives; b"" without one."""
    data = b""
    while len(data) < (size := size_of(data, MAX_PAYLOAD)) and (
        more := os.read(descriptor, size - len(data))
    ):
        data += more
    return data


def sandbox_for(first: bytes) -> None:
    """Applies the sandbox for the devices of an OpenDevices message, as far as the kernel supports it."""
    with suppress(WireError):
        for message in MessageReader().feed(first):
            if isinstance(message, OpenDevices):
                code = {*sys.path, sys.prefix, sys.base_prefix, *_packages()}
                own = filter(os.path.isabs, code)
                scratch, recording = str(temporary_dir()), message.recording.folder
                needed = policy_for(message.devices, message.driver, own, scratch, recording)
                _apply(needed)


def _apply(needed: SandboxPolicy) -> None:
    try:
        apply_sandbox(needed)
    except OSError as error:
        print(f"the guard keeps all rights of its user: {error.strerror}", file=sys.stderr)


def _packages() -> Iterator[str]:
    """Folders of modules that are found outside the path, such as those of an editable install."""
    for finder in sys.meta_path:
        mapping = getattr(sys.modules.get(getattr(finder, "__module__", "")), "MAPPING", {})
        yield from map(str, mapping.values() if isinstance(mapping, dict) else ())


def main(arguments: Sequence[str]) -> int:
    """Runs the guard of the plugin `package:PLUGIN`."""
    if len(arguments) != 1:
        print("usage: python -m lfield.guard.process package:PLUGIN", file=sys.stderr)
        return exit_status.USAGE
    # Output that a vendor library prints must not corrupt a frame, and must not block because of the reader
    # of the log.
    output_fd = os.dup(1)
    os.dup2(2, 1)
    sandbox_for(first := first_message(0))
    with nonblocking_output():
        try:
            plugin = load_plugin(arguments[0])
            return event_loop.run(serve(plugin, first, os.dup(0), output_fd))
        except LfieldError as error:
            print(error, file=sys.stderr)
            return error.exit_status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

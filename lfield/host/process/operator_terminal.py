"""Reads the operator's input from standard input: a terminal, a pipe or a file.

A thread reads, since a regular file has no readiness and a blocked read would stop the event loop. A process
in the background of a terminal does not read until it is in the foreground: the kernel would stop the
process, and with it the heartbeats to the guards.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress

from lfield.vm.waits.operator_input import MAX_LINE

#: The longest line that is collected, in bytes: four for each character, and as many for the name of a host.
#: The host shortens the line.
_MAX_BYTES = 8 * MAX_LINE
#: The bytes of one read.
_CHUNK = 4096
#: Seconds between two attempts of a process in the background.
_BACKGROUND_INTERVAL = 1.0


class LineSplitter:
    """Makes lines of bytes; UTF-8, with U+FFFD for invalid bytes."""

    def __init__(self, on_line: Callable[[str], None]) -> None:
        self._on_line, self._partial = on_line, b""

    def feed(self, data: bytes) -> None:
        """More bytes of the stream."""
        *ended, incomplete = data.split(b"\n")
        for part in ended:
            self._append(part)
            self._end()
        self._append(incomplete)

    def close(self) -> None:
        """The stream has ended; its last line may lack a newline."""
        if self._partial:
            self._end()

    def _append(self, part: bytes) -> None:
        self._partial = (self._partial + part)[:_MAX_BYTES]

    def _end(self) -> None:
        line, self._partial = self._partial, b""
        self._on_line(line.removesuffix(b"\r").decode(errors="replace"))


def read_standard_input(on_line: Callable[[str], None]) -> None:
    """Pass each line of standard input to `on_line`, in the running loop; no line if standard input is
    closed.
    """
    if sys.stdin is None:
        return
    loop, descriptor = asyncio.get_running_loop(), sys.stdin.fileno()
    lines = LineSplitter(on_line)

    def read() -> None:
        for data in _chunks(descriptor):
            if not _pass_on(loop, lines.feed, data):
                return
        _pass_on(loop, lines.close)

    if os.isatty(descriptor):
        signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    threading.Thread(target=read, name="operator input", daemon=True).start()


def _chunks(descriptor: int) -> Iterator[bytes]:
    """The bytes of a descriptor until its end."""
    while True:
        try:
            data = os.read(descriptor, _CHUNK)
        except OSError:
            if not _is_in_background(descriptor):
                return
            time.sleep(_BACKGROUND_INTERVAL)
            continue
        if not data:
            return
        yield data


def _is_in_background(descriptor: int) -> bool:
    with suppress(OSError):
        return os.tcgetpgrp(descriptor) != os.getpgrp()
    return False


def _pass_on(loop: asyncio.AbstractEventLoop, function: Callable[..., None], *values: bytes) -> bool:
    """Call a function in the loop; False when the loop has ended."""
    with suppress(RuntimeError):
        loop.call_soon_threadsafe(function, *values)
        return True
    return False

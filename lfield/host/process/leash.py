"""What a host has from the process that started it: descriptors, and news over its standard input.

A line is news: `reaped bravo` says that the process of another host has ended for good. The end of the stream
means that whoever holds the other end has gone, or wants this host to stop.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from contextlib import suppress

#: Input, output and what goes wrong: those that everybody has.
_STANDARD = 3
#: What a line begins with that tells of a host that has ended.
REAPED = "reaped "
#: A longer line is none of ours.
_LONGEST = 4096


def news(host: str) -> bytes:
    """The line that tells of a host whose process has ended."""
    return f"{REAPED}{host}\n".encode()


def keep_for_oneself() -> None:
    """Hand on to guards and fakes nothing that this process was given, as the socket that it is called at.

    They outlive a host that was killed: who calls that would be let in by a socket that nobody reads.
    """
    for name in os.listdir("/proc/self/fd"):
        # That of the folder is closed by now.
        with suppress(OSError):
            if int(name) >= _STANDARD:
                os.set_inheritable(int(name), False)


class Leash:
    """Reads one descriptor in the running loop until its end; never waits for it."""

    def __init__(self, descriptor: int, reaped: Callable[[str], None], let_go: Callable[[], None]) -> None:
        self._descriptor, self._reaped, self._let_go = descriptor, reaped, let_go
        self._loop = asyncio.get_running_loop()
        self._begun = b""
        os.set_blocking(descriptor, False)
        self._loop.add_reader(descriptor, self._read)

    def _read(self) -> None:
        try:
            data = os.read(self._descriptor, _LONGEST)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._loop.remove_reader(self._descriptor)
            self._let_go()
            return
        *lines, self._begun = (self._begun + data).split(b"\n")
        self._begun = self._begun[-_LONGEST:]
        for line in lines:
            self._news(line.decode(errors="replace"))

    def _news(self, line: str) -> None:
        if line.startswith(REAPED):
            self._reaped(line.removeprefix(REAPED))

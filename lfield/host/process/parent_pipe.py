"""Supervision pipe from the parent process: file descriptors, and reports over standard input.

A line is a report: `reaped bravo` says that the process of another host has exited and will not restart, and
`typed TEXT` is a line of the operator's input. The end of the stream means that the parent process has ended,
or requests this host to stop.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress

from lfield.event_loop import read_until_end
from lfield.wire.fields import MAX_INPUT

#: Standard input, output and error.
_STANDARD = 3
#: The prefix of a line that reports the end of a host process.
EXITED_PREFIX = "reaped "
#: The prefix of a line of the operator's input.
TYPED_PREFIX = "typed "
#: A longer line is ignored.
_MAX_LINE = 8192


def exit_line(host: str) -> bytes:
    """The line that reports that the process of a host has ended."""
    return f"{EXITED_PREFIX}{host}\n".encode()


def typed_line(text: str) -> bytes:
    """The line that passes on the operator's input; a long one is shortened to a length that the host reports
    as too long.
    """
    return f"{TYPED_PREFIX}{text[: MAX_INPUT + 1]}\n".encode()


def set_cloexec_on_all() -> None:
    """Do not pass the descriptors of this process, such as its listening socket, to guards and simulated
    devices.

    They outlive a killed host: a caller would connect to a socket that no process reads.
    """
    for name in os.listdir("/proc/self/fd"):
        # The descriptor of the folder itself is closed now.
        with suppress(OSError):
            if int(name) >= _STANDARD:
                os.set_inheritable(int(name), False)


class ParentPipe:
    """Reads one descriptor in the running loop until its end, without blocking."""

    def __init__(
        self,
        descriptor: int,
        on_host_exited: Callable[[str], None],
        on_parent_exit: Callable[[], None],
        on_typed: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._on_host_exited, self._on_parent_exit, self._on_typed = on_host_exited, on_parent_exit, on_typed
        self._partial_line = b""
        read_until_end(descriptor, self._on_data)

    def _on_data(self, data: bytes) -> None:
        if not data:
            self._on_parent_exit()
            return
        *lines, self._partial_line = (self._partial_line + data).split(b"\n")
        self._partial_line = self._partial_line[-_MAX_LINE:]
        for line in lines:
            self._on_line(line.decode(errors="replace"))

    def _on_line(self, line: str) -> None:
        if line.startswith(EXITED_PREFIX):
            self._on_host_exited(line.removeprefix(EXITED_PREFIX))
        elif line.startswith(TYPED_PREFIX):
            self._on_typed(line.removeprefix(TYPED_PREFIX))

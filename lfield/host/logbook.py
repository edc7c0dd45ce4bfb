"""Where a host's output goes: what programs write to stdout exactly as written, all else to stderr."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import TextIO


class Logbook:
    """Two streams. A stream that cannot be written (a full disk, a reader that left) is given up with one
    sentence on the other; the host and its agents go on."""

    def __init__(self, out: TextIO | None = None, log: TextIO | None = None) -> None:
        self._out: TextIO | None = out or sys.stdout
        self._log: TextIO | None = log or sys.stderr
        self._pending: list[str] = []

    def write(self, text: str) -> None:
        """Program output, kept until `flush`."""
        self._pending.append(text)

    def flush(self) -> None:
        """Let out what was written."""
        if not self._pending:
            return
        text, self._pending = "".join(self._pending), []
        if self._out is None:
            return
        try:
            self._out.write(text)
            self._out.flush()
        except (OSError, ValueError) as error:
            silence(self._out)
            self._out = None
            self.note(lost(error))

    def note(self, text: str) -> None:
        """A line of the log."""
        self.flush()
        if self._log is None:
            return
        try:
            self._log.write(text + "\n")
            self._log.flush()
        except (OSError, ValueError):
            silence(self._log)
            self._log = None


def lost(error: Exception) -> str:
    """The sentence on output that cannot be written."""
    reason = error.strerror if isinstance(error, OSError) else None
    return f"program output is lost from here on: {reason or error}"


def silence(stream: TextIO) -> None:
    """Let what is still to come out of a stream go nowhere; at exit Python would stumble over it again."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)

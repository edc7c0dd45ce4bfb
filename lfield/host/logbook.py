"""Where a host's output goes: what programs write to stdout exactly as written, all else to stderr."""

from __future__ import annotations

import sys
from typing import TextIO

from lfield.text.visible import continued, in_one_line


class Logbook:
    """Two streams, outlets in a host's process (text/outlet.py): neither makes the host wait, or fails."""

    def __init__(self, out: TextIO | None = None, log: TextIO | None = None) -> None:
        # None where the process was started without the stream.
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
        if self._out is not None:
            self._out.write(text)
            self._out.flush()

    def note(self, text: str, *, lines: bool = False) -> None:
        """A line of the log: what persons and other hosts say in it orders no terminal, and begins no other.

        What a program says may have `lines`, of which all but the first stand further in.
        """
        self.flush()
        if self._log is not None:
            self._log.write((continued if lines else in_one_line)(text) + "\n")
            self._log.flush()

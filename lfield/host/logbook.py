"""Output of a host: what programs write goes to stdout, log lines go to stderr.

Program output goes out unchanged, unless stdout is a terminal: there every character that controls a terminal
is shown as an escape of L, since a program may be another person's, and a terminal obeys what it reads.
"""

from __future__ import annotations

import sys
from typing import TextIO

from lfield.text.visible import continued, in_one_line, visible


class Logbook:
    """Two streams, outlets in a host's process (text/outlet.py): neither makes the host wait, or fails."""

    def __init__(self, out: TextIO | None = None, log: TextIO | None = None) -> None:
        # None where the process was started without the stream.
        self._out: TextIO | None = out or sys.stdout
        self._log: TextIO | None = log or sys.stderr
        self._is_terminal = self._out is not None and self._out.isatty()
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
            self._out.write(visible(text) if self._is_terminal else text)
            self._out.flush()

    def note(self, text: str, *, lines: bool = False) -> None:
        """A line of the log: what persons and other hosts say in it orders no terminal, and begins no other.

        What a program says may have `lines`, of which all but the first stand further in.
        """
        self.flush()
        if self._log is not None:
            self._log.write((continued if lines else in_one_line)(text) + "\n")
            self._log.flush()

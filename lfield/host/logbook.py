"""Output of a host: what programs write goes to stdout, log lines go to stderr.

Program output is unchanged, unless stdout is a terminal: there every control character is shown as an escape
of L, since a program of another author must not be able to control the terminal.
"""

from __future__ import annotations

import sys
from typing import TextIO

from lfield.text.log_messages import LogLine
from lfield.text.terminal_escape import escape, escape_indented, escape_line


class Logbook:
    """Two non-blocking streams (text/nonblocking_output.py): writing neither blocks nor fails."""

    def __init__(self, out: TextIO | None = None, log: TextIO | None = None) -> None:
        # None where the process was started without the stream.
        self._out: TextIO | None = out or sys.stdout
        self._log: TextIO | None = log or sys.stderr
        self._is_terminal = self._out is not None and self._out.isatty()
        #: Output that waits for `flush`.
        self.pending: list[str] = []
        #: The newest error of each code, in the order of time.
        self.errors: dict[str, str] = {}

    def write(self, text: str) -> None:
        """Program output, buffered until `flush`."""
        self.pending.append(text)

    def flush(self) -> None:
        """Write the buffered output."""
        if not self.pending:
            return
        text, self.pending = "".join(self.pending), []
        if self._out is not None:
            self._out.write(escape(text) if self._is_terminal else text)
            self._out.flush()

    def note(self, text: str, *, lines: bool = False) -> None:
        """Write a log line; control characters and line breaks in it are escaped.

        Program output may have several `lines`; all but the first are indented.
        """
        self.flush()
        if isinstance(text, LogLine) and text.level == "error":
            self.errors.pop(text.code, None)
            self.errors[text.code] = text
        if self._log is not None:
            self._log.write((escape_indented if lines else escape_line)(text) + "\n")
            self._log.flush()

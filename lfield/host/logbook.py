"""Output of a host: program output goes to stdout, log lines go to stderr.

Program output is unchanged, unless stdout is a terminal: there every control character is shown as an escape
of L, since a program of another author must not be able to control the terminal.
"""

from __future__ import annotations

import sys
from typing import TextIO

from lfield.clock import Clock
from lfield.text import log_messages
from lfield.text.log_messages import LogLine, json_line
from lfield.text.terminal_escape import escape, escape_indented, escape_line

#: The longest line without an end that a program may write as JSON, in characters.
MAX_INCOMPLETE = 1 << 16


class Logbook:
    """Two non-blocking streams (text/nonblocking_output.py): writing neither blocks nor fails."""

    def __init__(self, out: TextIO | None = None, log: TextIO | None = None) -> None:
        # None if the process was started without the stream.
        self._out: TextIO | None = out or sys.stdout
        self._log: TextIO | None = log or sys.stderr
        self._is_terminal = self._out is not None and self._out.isatty()
        #: Output that waits for `flush`.
        self.pending: list[str] = []
        #: The newest error of each code, in the order of time.
        self.errors: dict[str, str] = {}

    def write(self, text: str, agent: str) -> None:
        """Output of an agent's program, buffered until `flush`."""
        self.pending.append(text)

    def flush(self) -> None:
        """Write the buffered output."""
        if not self.pending:
            return
        text, self.pending = "".join(self.pending), []
        if self._out is not None:
            self._out.write(escape(text) if self._is_terminal else text)
            self._out.flush()

    def close(self) -> None:
        """Write the rest of the output at the end."""
        self.flush()

    def note(self, text: LogLine, *, lines: bool = False) -> None:
        """Write a log line; control characters and line breaks in it are escaped.

        Program output may have several `lines`; all but the first are indented.
        """
        self.flush()
        self._keep_error(text)
        if self._log is not None:
            self._log.write((escape_indented if lines else escape_line)(text) + "\n")
            self._log.flush()

    def _keep_error(self, line: LogLine) -> None:
        if line.level == "error":
            self.errors.pop(line.code, None)
            self.errors[line.code] = line


class JsonLogbook(Logbook):
    """Output as one JSON object for each line, on stdout: log lines and the lines that programs write."""

    def __init__(self, host: str, clock: Clock, out: TextIO | None = None) -> None:
        super().__init__(out)
        self._host, self._clock = host, clock
        #: The output of each agent since its last complete line.
        self._incomplete: dict[str, str] = {}

    def write(self, text: str, agent: str) -> None:
        """Output of an agent's program; each line is written when it is complete."""
        *lines, incomplete = (self._incomplete.pop(agent, "") + text).split("\n")
        if len(incomplete) > MAX_INCOMPLETE:
            lines, incomplete = [*lines, incomplete], ""
        if incomplete:
            self._incomplete[agent] = incomplete
        for line in lines:
            self._print(log_messages.PROGRAM_OUTPUT.line(agent=agent, text=line))

    def close(self) -> None:
        """Write the incomplete lines."""
        for agent in list(self._incomplete):
            self.write("\n", agent)

    def note(self, text: LogLine, *, lines: bool = False) -> None:
        """Write a log line."""
        self._keep_error(text)
        self._print(text)

    def _print(self, line: LogLine) -> None:
        if self._out is not None:
            self._out.write(json_line(self._clock.time(), self._host, line))
            self._out.flush()

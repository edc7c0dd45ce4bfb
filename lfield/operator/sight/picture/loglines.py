"""The log of a team: what hosts and programs say, line by line, the last ones. Pure."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from lfield.operator.sight.seen import LogLine
from lfield.wire.events import Printed

#: So many lines are kept.
MOST_LINES = 1000
#: A line that a program does not end is one after so many characters.
LONGEST = 4096


@dataclass(frozen=True, slots=True)
class _Line:
    serial: int
    host: str
    at: float
    when: float
    agent: str
    text: str


class LogLines:
    """The last lines of all hosts, in the order in which they came here."""

    def __init__(self) -> None:
        self._lines: deque[_Line] = deque(maxlen=MOST_LINES)
        self._serial = 0
        #: What a program on a host has written since its last line ended.
        self._begun: dict[tuple[str, str], str] = {}

    def add(self, host: str, at: float, when: float, agent: str, text: str) -> None:
        """Lines of a host, said at its time `at`, which was `when` by our monotonic clock."""
        for line in text.splitlines() or [""]:
            self._serial += 1
            self._lines.append(_Line(self._serial, host, at, when, agent, line))

    def printed(self, host: str, at: float, when: float, what: Printed) -> None:
        """What a program has said: a line, or what it has written of one."""
        if what.on == "log":
            self.add(host, at, when, what.agent, what.text)
            return
        key = (host, what.agent)
        whole = self._begun.pop(key, "") + what.text
        *lines, rest = whole.split("\n")
        if len(rest) > LONGEST:
            lines, rest = [*lines, rest], ""
        for line in lines:
            self.add(host, at, when, what.agent, line)
        if rest:
            self._begun[key] = rest

    def seen(self, now: float) -> tuple[LogLine, ...]:
        """All of them, the oldest first."""
        return tuple(
            LogLine(line.serial, line.host, line.at, max(0.0, now - line.when), line.agent, line.text)
            for line in self._lines
        )

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


class Pieces:
    """What programs print, as lines, whatever pieces they write."""

    def __init__(self) -> None:
        #: What a program on a host has written since its last line ended.
        self._begun: dict[tuple[str, str], str] = {}

    def lines(self, host: str, what: Printed) -> list[str]:
        """The lines that have ended now."""
        if what.on == "log":
            return what.text.splitlines() or [""]
        key = (host, what.agent)
        *lines, rest = (self._begun.pop(key, "") + what.text).split("\n")
        if len(rest) > LONGEST:
            lines, rest = [*lines, rest], ""
        if rest:
            self._begun[key] = rest
        return lines


class LogLines:
    """The last lines of all hosts, in the order in which they came here."""

    def __init__(self) -> None:
        self._lines: deque[_Line] = deque(maxlen=MOST_LINES)
        self._serial = 0
        self._pieces = Pieces()

    def add(self, host: str, at: float, when: float, agent: str, text: str) -> None:
        """Lines of a host, said at its time `at`, which was `when` by our monotonic clock."""
        for line in text.splitlines() or [""]:
            self._serial += 1
            self._lines.append(_Line(self._serial, host, at, when, agent, line))

    def printed(self, host: str, at: float, when: float, what: Printed) -> None:
        """What a program has said: a line, or what it has written of one."""
        for line in self._pieces.lines(host, what):
            self.add(host, at, when, what.agent, line)

    def seen(self, now: float) -> tuple[LogLine, ...]:
        """All of them, the oldest first."""
        return tuple(
            LogLine(line.serial, line.host, line.at, max(0.0, now - line.when), line.agent, line.text)
            for line in self._lines
        )

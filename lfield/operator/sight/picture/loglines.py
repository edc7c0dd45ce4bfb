"""The log of a team: what hosts and programs say, line by line, the last ones. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from lfield.operator.sight.seen import LogLine
from lfield.wire.events import Logged, Printed, Skipped

#: So many lines are kept.
MOST_LINES = 1000
#: A line that a program does not end is one after so many characters.
LONGEST = 4096


#: What of a stream makes lines.
Words = Printed | Logged | Skipped


class Said(NamedTuple):
    """What was said on a host, at `when` by our monotonic clock."""

    host: str
    when: float
    what: Words


def left_out(what: str, count: int) -> str:
    """What is said of what a host did not tell."""
    return f"{count} {what} were not told: they came too often"


def lines_of(text: str) -> list[str]:
    """Its lines as the log of its host has them: whatever else a program writes begins none."""
    return text.removesuffix("\n").split("\n")


@dataclass(frozen=True, slots=True)
class _Line:
    serial: int
    host: str
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
            return lines_of(what.text)
        key = (host, what.agent)
        *lines, rest = (self._begun.pop(key, "") + what.text).split("\n")
        if len(rest) > LONGEST:
            lines, rest = [*lines, rest], ""
        if rest:
            self._begun[key] = rest
        return lines


class LogLines:
    """The last lines of all hosts, in the order in which they came here.

    By so many seconds (`ahead`) Unix time is ahead of our monotonic clock.
    """

    def __init__(self, ahead: float) -> None:
        self._ahead = ahead
        #: When each host said its last line. What is known of its clock gets better: no line goes back.
        self._last: dict[str, float] = {}
        self._lines: deque[_Line] = deque(maxlen=MOST_LINES)
        self._serial = 0
        self._pieces = Pieces()
        #: What waits for what was said before it, None when nothing does.
        self._held: deque[Said] | None = None

    def hold(self) -> None:
        """What is said from now on waits until it is known what was said before."""
        self._held = deque(maxlen=MOST_LINES)

    def begin(self, before: Iterable[Said]) -> None:
        """That was said before all else; nothing waits any more."""
        held, self._held = self._held or (), None
        for said in (*before, *held):
            self.add(said)

    def add(self, said: Said) -> None:
        """It was said after all that was said before."""
        if self._held is not None:
            self._held.append(said)
            return
        match said.what:
            case Printed(agent) as what:
                # A line, or what a program has written of one.
                for line in self._pieces.lines(said.host, what):
                    self._line(said, agent, line)
            case Logged(text):
                self._line(said, "", text)
            case Skipped("printed", count):
                self._line(said, "", left_out("lines", count))

    def _line(self, said: Said, agent: str, text: str) -> None:
        when = self._last[said.host] = max(said.when, self._last.get(said.host, said.when))
        for line in lines_of(text):
            self._serial += 1
            self._lines.append(_Line(self._serial, said.host, when, agent, line))

    def seen(self, now: float) -> tuple[LogLine, ...]:
        """All of them, the oldest first."""
        return tuple(
            LogLine(
                line.serial,
                line.host,
                line.when + self._ahead,
                max(0.0, now - line.when),
                line.agent,
                line.text,
            )
            for line in self._lines
        )

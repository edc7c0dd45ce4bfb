"""The log of a team: the last lines of hosts and programs. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

from msgspec import Struct

from lfield.hybrid_clock import counter_of, milliseconds_of
from lfield.operator.team_model.team_state import ShownLogLine
from lfield.wire.events import EventsDropped, LineLogged, Printed

#: Maximum number of lines.
MAX_LINES = 1000
#: Maximum length of a line (characters): a longer one is broken.
MAX_LENGTH = 4096


#: The events of a stream that make lines.
LogEvent = Printed | LineLogged | EventsDropped


class LogRecord(NamedTuple):
    """A log event of a host, at `when` by the local monotonic clock and with the timestamp `stamp`."""

    host: str
    when: float
    stamp: int
    what: LogEvent


def lost_events_text(subject: str, count: int) -> str:
    """The line about events that a host left out."""
    return f"{count} {subject} left out: too frequent"


def lines_of(text: str) -> list[str]:
    """The lines as in the log of the host: only a line feed begins a new one."""
    return text.removesuffix("\n").split("\n")


class _Line(Struct, frozen=True):
    serial: int
    host: str
    when: float
    stamp: int
    agent: str
    text: str


class LineAssembler:
    """Assembles the output of programs into lines."""

    def __init__(self) -> None:
        #: The text that a program on a host has written since its last line ended.
        self._incomplete: dict[tuple[str, str], str] = {}

    def lines(self, host: str, printed: Printed) -> list[str]:
        """The lines that have ended now."""
        if printed.on == "log":
            return lines_of(printed.text)
        key = (host, printed.agent)
        *lines, remainder = (self._incomplete.pop(key, "") + printed.text).split("\n")
        if len(remainder) > MAX_LENGTH:
            lines, remainder = [*lines, remainder], ""
        if remainder:
            self._incomplete[key] = remainder
        return lines


class LogBuffer:
    """The last lines of all hosts, in the order of their arrival."""

    def __init__(self) -> None:
        #: The timestamp of the last line of each host: a later incarnation may have an earlier clock.
        self._last: dict[str, int] = {}
        self._lines: deque[_Line] = deque(maxlen=MAX_LINES)
        self._serial = 0
        self._pieces = LineAssembler()
        #: Events that wait for the backlog, None when none is awaited.
        self._held: deque[LogRecord] | None = None

    def hold(self) -> None:
        """Hold back new events until the backlog arrives."""
        self._held = deque(maxlen=MAX_LINES)

    def start(self, before: Iterable[LogRecord]) -> None:
        """Add the backlog, then the events held back."""
        held, self._held = self._held or (), None
        for record in (*before, *held):
            self.add(record)

    def add(self, record: LogRecord) -> None:
        """Add a new event."""
        if self._held is not None:
            self._held.append(record)
            return
        match record.what:
            case Printed(agent) as what:
                # A line, or the part of a line that a program has written.
                for line in self._pieces.lines(record.host, what):
                    self._add_line(record, agent, line)
            case LineLogged(text):
                self._add_line(record, "", text)
            case EventsDropped("printed", count):
                self._add_line(record, "", lost_events_text("lines", count))

    def _add_line(self, record: LogRecord, agent: str, text: str) -> None:
        stamp = self._last[record.host] = max(record.stamp, self._last.get(record.host, 0))
        for line in lines_of(text):
            self._serial += 1
            self._lines.append(_Line(self._serial, record.host, record.when, stamp, agent, line))

    def snapshot(self, now: float) -> tuple[ShownLogLine, ...]:
        """All lines, the oldest first."""
        return tuple(
            ShownLogLine(
                line.serial,
                line.host,
                milliseconds_of(line.stamp) / 1000.0,
                max(0.0, now - line.when),
                line.agent,
                line.text,
                counter_of(line.stamp),
            )
            for line in self._lines
        )

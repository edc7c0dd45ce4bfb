"""Events as text, JSON or CSV, one line each."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Iterator

from lfield.client.event_json import json_line
from lfield.operator.dashboard.timeline.event_timeline import DatedEvent
from lfield.operator.team_model.log_buffer import LineAssembler, lines_of
from lfield.text import log_messages
from lfield.text.log_messages import Level, LogLine
from lfield.text.terminal_escape import escape_line
from lfield.text.value_text import byte_count_text, duration_text, percentage_text
from lfield.wire.events import (
    DeviceTelemetry,
    EventsDropped,
    LineLogged,
    LinkTelemetry,
    MigrationArrived,
    MigrationConfirmed,
    MigrationFailed,
    MigrationStarted,
    Printed,
)
from lfield.wire.fields import Telemetry
from lfield.wire.subscription_messages import as_fields

#: The kinds in CSV: telemetry and link measurements (a row for each number), and hops.
CSV_KINDS = ("measured", "path", "left", "came", "hopped", "stayed")
COLUMNS = (
    *("time", "within", "host", "number", "kind", "of", "quantity", "value"),
    *("generation", "sequence", "from", "to", "seconds", "size"),
)


def event_line(dated: DatedEvent) -> str:
    """`12:34:56.789  alpha  #9  left  agent=boss ...`, in the local time of this computer."""
    fields = as_fields(dated.event)
    texts = [f"{name}={_value_text(value)}" for name, value in fields.items() if name not in _HEAD]
    if isinstance(dated.event.what, LinkTelemetry):
        texts = list(_measured(dated.event.what))
    caused = f"by={dated.cause.host}:{dated.cause.number}" if dated.cause is not None else ""
    number = f"#{fields['number']}"
    return "  ".join(
        filter(None, (clock_time(dated), escape_line(dated.host), number, fields["kind"], *texts, caused))
    )


def _measured(path: LinkTelemetry) -> Iterator[str]:
    """The known measurements of a link with their units."""
    yield f"peer={escape_line(path.peer)}"
    if path.round_trip is not None:
        yield f"round_trip={duration_text(path.round_trip)}"
    if path.loss is not None:
        yield f"loss={percentage_text(path.loss)}"
    if path.sent is not None:
        yield f"sent={byte_count_text(path.sent)}"
    if path.received is not None:
        yield f"received={byte_count_text(path.received)}"


_HEAD = ("number", "at", "up", "cause", "kind")


def _value_text(value: object) -> str:
    if isinstance(value, str):
        text = escape_line(value)
        return text if text and " " not in text else f'"{text}"'
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict):
        return (
            "{" + ", ".join(f"{escape_line(name)}: {_value_text(each)}" for name, each in value.items()) + "}"
        )
    if isinstance(value, list):
        return "[" + ", ".join(map(_value_text, value)) + "]"
    return _boolean_text(value) if isinstance(value, bool) else str(value)


def _boolean_text(value: bool) -> str:
    return "true" if value else "false"


def clock_time(dated: DatedEvent) -> str:
    """The time of day, to the millisecond."""
    whole, part = divmod(round(dated.time * 1000), 1000)
    try:
        return f"{time.strftime('%H:%M:%S', time.localtime(whole))}.{part:03d}"
    except (OverflowError, OSError, ValueError):
        return f"{whole}.{part:03d}"


class EventCsv:
    """Rows of one table; the first line names the columns."""

    def __init__(self) -> None:
        self._buffer = io.StringIO()
        self._writer = csv.writer(self._buffer, lineterminator="\n")

    def header(self) -> str:
        """The names of the columns."""
        return self._line(COLUMNS)

    def rows(self, dated: DatedEvent) -> Iterator[str]:
        """The rows of an event, none for a kind that is not in CSV."""
        within = "" if dated.within is None else f"{dated.within:.6f}"
        head = (f"{dated.time:.6f}", within, dated.host, dated.event.number, dated.event.kind)
        for row in _rows(dated):
            yield self._line((*head, *row))

    def _line(self, row: tuple[object, ...]) -> str:
        self._writer.writerow(map(_cell, row))
        line = self._buffer.getvalue().removesuffix("\n")
        self._buffer.seek(0)
        self._buffer.truncate()
        return line


def _rows(dated: DatedEvent) -> Iterator[tuple[object, ...]]:
    hop: tuple[object, ...]
    match dated.event.what:
        case DeviceTelemetry(device, values):
            for name, value in values.items():
                for quantity, each in _numbers(name, value):
                    yield (device, quantity, each, "", "", "", "", "", "")
            return
        case LinkTelemetry(peer) as path:
            for quantity in ("round_trip", "loss", "sent", "received"):
                if (value := getattr(path, quantity)) is not None:
                    yield (peer, quantity, value, "", "", "", "", "", "")
            return
        case MigrationStarted(agent, generation, sequence, to, _, _, size):
            hop = (generation, sequence, dated.host, to, "", size)
        case MigrationArrived(agent, generation, sequence, of, size):
            hop = (generation, sequence, of, dated.host, "", size)
        case MigrationConfirmed(agent, generation, sequence, to, seconds):
            hop = (generation, sequence, dated.host, to, "" if seconds is None else seconds, "")
        case MigrationFailed(agent, generation, sequence, to):
            hop = (generation, sequence, dated.host, to, "", "")
        case _:
            return
    yield (agent, "", "", *hop)


def _numbers(name: str, value: Telemetry) -> Iterator[tuple[str, object]]:
    """The numbers of a quantity: each element of an array separately, `position[0]`."""
    if isinstance(value, list):
        yield from ((f"{name}[{place}]", each) for place, each in enumerate(value))
    else:
        yield name, _boolean_text(value) if isinstance(value, bool) else value


def _cell(value: object) -> object:
    return escape_line(value) if isinstance(value, str) else value


#: The levels of lines; a level of a later version counts as information.
_LEVELS: dict[str, Level] = {"warning": "warning", "error": "error"}


class LogLineView:
    """The log lines that are complete with an event."""

    def __init__(self) -> None:
        self._assembler = LineAssembler()

    def lines(self, dated: DatedEvent) -> Iterator[LogLine]:
        """The lines, without time and host; of a program with the agent."""
        match dated.event.what:
            case Printed(agent) as what:
                for line in self._assembler.lines(dated.host, what):
                    yield log_messages.PROGRAM_OUTPUT.line(agent=agent, text=line)
            case LineLogged(text, code, level):
                for line in lines_of(text):
                    yield LogLine(line, code, _LEVELS.get(level, "info"), {})
            case EventsDropped("printed", count):
                yield log_messages.OUTPUT_DROPPED.line(count=count)


def log_text(dated: DatedEvent, line: LogLine) -> str:
    """A log line with the time of this computer and the host."""
    return f"{clock_time(dated)} {escape_line(dated.host)} | {escape_line(line)}"


def log_json(dated: DatedEvent, line: LogLine) -> str:
    """The same as a JSON object; the text of a line of the host's log is all that its event has."""
    return json_line({"time": dated.time, "host": dated.host, **line.as_data()})

"""Events and log lines of devices from the recordings of guards; the cores of hosts do not emit them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple, cast

import msgspec

from lfield.guard.messages import MESSAGES, Latched, LockedOut, Moving, Released
from lfield.guard.recording.guard_records import NOTIFY, InputRecord, NoteRecord
from lfield.guard.recording.guard_segments import read_segments
from lfield.text import log_messages
from lfield.text.log_messages import Level, LogLine
from lfield.wire import events
from lfield.wire.fields import MAX_LABEL, truncate

_REPORTS = {NOTIFY + MESSAGES.index(kind): kind for kind in (Latched, LockedOut, Moving, Released)}


class DeviceEvent(NamedTuple):
    """An event of a device; `time` is that of the guard's monotonic clock, `wall_time` is since 1970."""

    time: float
    wall_time: float
    what: events.StateEvent


def device_events(paths: Iterable[Path]) -> Iterator[DeviceEvent]:
    """The events in the files of one ring, in their order: safe states, and what guard and driver logged.

    Raises RecordingError.
    """
    for segment in read_segments(paths):
        for record in segment.records:
            if segment.start is None or not isinstance(record, InputRecord | NoteRecord):
                continue
            wall_time = segment.start.wall_time + record.time - segment.start.monotonic
            for what in _events_of(record):
                yield DeviceEvent(record.time, wall_time, what)


def _events_of(record: InputRecord | NoteRecord) -> Iterator[events.StateEvent]:
    if isinstance(record, NoteRecord):
        level = cast(Level, record.level)
        yield _logged(log_messages.report_line(record.device, record.text, record.code, level))
        return
    decoded = msgspec.msgpack.decode(record.decisions)
    for kind, *fields in decoded if isinstance(decoded, list) else ():
        if kind in _REPORTS:
            yield from _reported(_REPORTS[kind](*fields))


def _reported(message: Latched | LockedOut | Moving | Released) -> Iterator[events.StateEvent]:
    """The event and the log line of a message of the guard, as a host makes them."""
    device = truncate(message.device, MAX_LABEL)
    match message:
        case Latched(_, reason, is_confirmed, state):
            kind = events.SafeStateConfirmed if is_confirmed else events.DeviceLatched
            yield kind(device, truncate(state, MAX_LABEL), truncate(reason))
            line = log_messages.DEVICE_SAFE if is_confirmed else log_messages.DEVICE_GOES_SAFE
            yield _logged(line.line(device=device, state=state, reason=reason))
        case LockedOut(_, reason):
            yield _logged(log_messages.DEVICE_LOCKED_OUT.line(device=device, reason=reason))
        case Moving(_, moving):
            yield events.DeviceMoving(device, truncate(moving))
        case Released():
            yield events.DeviceReleased(device)
            yield _logged(log_messages.DEVICE_RELEASED.line(device=device))


def _logged(line: LogLine) -> events.LineLogged:
    return events.LineLogged(truncate(str(line)), line.code, line.level)

"""Events and log lines of devices from the recordings of guards; the cores of hosts do not emit them."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, cast

import msgspec

from lfield.devices.guard_process import STOPPING
from lfield.guard.messages import MESSAGES, Latched, LockedOut, Moving, Released
from lfield.guard.recording.guard_records import NOTIFY, InputRecord, NoteRecord, SegmentStart
from lfield.guard.recording.guard_segments import read_segments, rings_in
from lfield.replay.host_recording import HostRecording, OutsideEvent
from lfield.replay.recording_files import TeamRecording
from lfield.text import log_messages
from lfield.text.log_messages import Level, LogLine
from lfield.wire import events
from lfield.wire.fields import MAX_LABEL, truncate

_REPORTS = {NOTIFY + MESSAGES.index(kind): kind for kind in (Latched, LockedOut, Moving, Released)}


#: Seconds between the times at which guard and host log one line.
SAME_LINE = 5.0


class DeviceEvent(NamedTuple):
    """An event of a device; `time` is that of the guard's monotonic clock, `wall_time` is since 1970."""

    time: float
    wall_time: float
    what: events.StateEvent


def device_events(paths: Iterable[Path], logged: Collection[OutsideEvent] = ()) -> Iterator[DeviceEvent]:
    """The events in the files of one ring, in their order: safe states, and lines logged by guard and driver.

    Lines that the host has also `logged` at about the same time are omitted.
    """
    times: dict[str, list[float]] = {}
    for event in logged:
        if isinstance(event.what, events.LineLogged):
            times.setdefault(event.what.text, []).append(event.at)
    for found in _all_events(paths):
        known = times.get(found.what.text, ()) if isinstance(found.what, events.LineLogged) else ()
        if not any(abs(found.time - at) < SAME_LINE for at in known):
            yield found


def _all_events(paths: Iterable[Path]) -> Iterator[DeviceEvent]:
    for segment in read_segments(paths):
        for record in segment.records:
            if segment.start is None or not isinstance(record, InputRecord | NoteRecord):
                continue
            wall_time = segment.start.wall_time + record.time - segment.start.monotonic
            for event in _events_of(record, segment.start):
                yield DeviceEvent(record.time, wall_time, event)


def _events_of(record: InputRecord | NoteRecord, start: SegmentStart) -> Iterator[events.StateEvent]:
    if isinstance(record, NoteRecord):
        level = cast(Level, record.level)
        yield _logged(log_messages.report_line(record.device, record.text, record.code, level))
        return
    decoded = msgspec.msgpack.decode(record.decisions)
    # Other decisions are in a damaged recording only, and a difference in its replay.
    with suppress(TypeError, ValueError):
        reports = (_REPORTS[kind](*fields) for kind, *fields in decoded if kind in _REPORTS)
        yield from [event for report in reports for event in _reported(report, start)]


def _reported(
    message: Latched | LockedOut | Moving | Released, start: SegmentStart
) -> Iterator[events.StateEvent]:
    """The event and the log line that a host makes of a message of the guard."""
    device = truncate(message.device, MAX_LABEL)
    match message:
        case Latched(_, reason, is_confirmed, state):
            # '' is the safe state of the binding.
            state = state or next((d.safe_state for d in start.devices if d.name == message.device), "")
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


def with_device_events(recording: TeamRecording) -> TeamRecording:
    """The same recording, in which the parts have the events of their devices too."""
    for incarnation in recording.incarnations:
        parts = incarnation.parts
        for paths in rings_in(incarnation.folder).values():
            events_of_ring = device_events(paths, outside_events(parts))
            found = [OutsideEvent(each.time, each.what) for each in events_of_ring]
            edges = [*(part.started_at for part in parts), math.inf]
            for part, (start, stop) in zip(parts, pairwise(edges), strict=True):
                part.add_outside_events(each for each in found if start <= each.at < stop)
    return recording


def outside_events(parts: Iterable[HostRecording]) -> list[OutsideEvent]:
    """The events of a host that its core did not make."""
    return [each for part in parts for each in part.outside_events]


class SafetyStop(NamedTuple):
    """An emergency stop by an operator, or a device that went into its safe state while its host ran.

    `at` is in seconds since 1970, `line` the log line of the host.
    """

    host: str
    at: float
    device: str
    by: str
    reason: str
    line: str


def safety_stops(recording: TeamRecording) -> list[SafetyStop]:
    """The safety stops of a recording, by time; those of the ends of hosts are not among them."""
    stops: list[SafetyStop] = []
    for incarnation in recording.incarnations:
        host, start = incarnation.host, incarnation.parts[0].start
        for event in outside_events(incarnation.parts):
            if isinstance(event.what, events.EmergencyStopChanged) and not event.what.lifted:
                by, reason = event.what.by, event.what.reason
                line = str(log_messages.EMERGENCY_STOP.line(operator=by, reason=reason))
                stops.append(SafetyStop(host, start.wall + event.at - start.at, "", by, reason, line))
        for paths in rings_in(incarnation.folder).values():
            for each in device_events(paths):
                match each.what:
                    case events.DeviceLatched(device=device, state=state, reason=reason) if (
                        reason != STOPPING
                    ):
                        line = str(
                            log_messages.DEVICE_GOES_SAFE.line(device=device, state=state, reason=reason)
                        )
                        at = start.wall + each.time - start.at
                        stops.append(SafetyStop(host, at, device, "", reason, line))
    return sorted(stops, key=lambda stop: stop.at)

"""The events and telemetry of a recording, in the order of their times, for exports.

The events are those that the cores emit while they are replayed, with log lines. Events of devices and their
telemetry are in the recordings of the guards.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path
from typing import cast

from msgspec.structs import replace

from lfield.errors import RecordingError
from lfield.export.export_input import StreamItem, StreamNotice, TelemetrySample
from lfield.guard.recording.guard_segments import rings_in, telemetry_in
from lfield.host.effects import WriteLog
from lfield.host.events.portal_events import PortalEvents
from lfield.mission.mission import Mission
from lfield.operator.dashboard.timeline.event_timeline import Cause, DatedEvent
from lfield.replay.device_events import device_events, outside_events
from lfield.replay.host_recording import HostRecording, Turn
from lfield.replay.host_replay import HostReplay, ReplayedTurn
from lfield.replay.recording_files import Incarnation, TeamRecording
from lfield.replay.team_check import PROGRESS_TURNS, OnProgress
from lfield.replay.team_order import TeamOrder
from lfield.wire.events import Event
from lfield.wire.fields import Telemetry

#: Events of one turn.
_MAX_EVENTS, _MAX_BYTES = 1 << 16, 1 << 28


def event_stream(recording: TeamRecording, on_progress: OnProgress = lambda turns: None) -> list[StreamItem]:
    """All items of a recording, by time. A host that cannot be replayed further has a notice there.

    Raises RecordingError.
    """
    parts = [part for each in recording.incarnations for part in each.parts]
    order = TeamOrder(parts)
    shifts = [
        offset - (part.start.wall - part.start.at) for offset, part in zip(order.offsets, parts, strict=True)
    ]
    items: list[StreamItem] = list(_events(recording, order, shifts, on_progress))
    number = 0
    for incarnation in recording.incarnations:
        for paths in rings_in(incarnation.folder).values():
            items += _samples(incarnation, paths, shifts[number])
            items += _device_events(incarnation, paths, shifts[number])
        items += (
            StreamNotice(incarnation.started_at + shifts[number], incarnation.host, text)
            for text in incarnation.problems
        )
        number += len(incarnation.parts)
    items.sort(key=lambda item: item.time)
    return items


def _events(
    recording: TeamRecording, order: TeamOrder, shifts: list[float], on_progress: OnProgress
) -> Iterator[DatedEvent | StreamNotice]:
    sources = [
        _EventSource(part, recording.mission, shift) for part, shift in zip(order.parts, shifts, strict=True)
    ]
    for done, turn in enumerate(order, 1):
        if done % PROGRESS_TURNS == 0:
            on_progress(PROGRESS_TURNS)
        yield from sources[turn.part].replay(turn.record)


class _EventSource:
    """The events of one recording, whose clock is off by `shift` seconds.

    Their times follow the monotonic clock of the host, as those of telemetry do: its wall clock may jump.
    """

    def __init__(self, recording: HostRecording, mission: Mission, shift: float) -> None:
        self._recording, self._shift, self._latest = recording, shift, 0
        self._is_over, self._failure = False, ""
        try:
            self._replay = HostReplay(recording, mission)
        except RecordingError as error:
            self._failure = str(error)
            return
        self._turns = iter(self._replay)
        PortalEvents(self._replay.core.recorder, self._replay.core.machine).attach()

    def replay(self, record: Turn) -> Iterator[DatedEvent | StreamNotice]:
        """The events of the next turn, whose record is given; none after a difference."""
        if self._is_over:
            return
        start = self._recording.start
        time = record.at - start.at + start.wall + self._shift
        turn = None if self._failure else next(self._turns)
        if turn is None or turn.divergence is not None:
            self._is_over = True
            reason = self._failure or "'lfield replay' shows the difference"
            number = 0 if turn is None else turn.number
            text = f"the recording cannot be replayed from turn {number} on: {reason}"
            yield StreamNotice(time, start.host, text)
            return
        yield from self._events_of(turn)

    def _events_of(self, turn: ReplayedTurn) -> Iterator[DatedEvent]:
        start, recorder = self._recording.start, self._replay.core.recorder
        for effect in turn.effects:
            if isinstance(effect, WriteLog) and not effect.is_recorded:
                recorder.on_log_line(effect.text)
        recorder.drain()
        found, _ = recorder.event_log.after(self._latest, _MAX_EVENTS, _MAX_BYTES)
        for event in found:
            self._latest = event.number
            cause = Cause(start.host, start.incarnation, event.cause) if event.cause else None
            time = start.wall + event.up + self._shift
            yield DatedEvent(start.host, start.incarnation, replace(event, at=time, ahead=0, tick=0), cause)


def _device_events(incarnation: Incarnation, paths: Iterable[Path], shift: float) -> Iterator[DatedEvent]:
    start = incarnation.parts[0].start
    for found in device_events(paths, outside_events(incarnation.parts)):
        at, uptime = found.time - start.at + start.wall + shift, max(0.0, found.time - start.at)
        # The log of the host numbers its own events from 1 on.
        yield DatedEvent(incarnation.host, start.incarnation, Event(0, at, uptime, 0, found.what), None)


def _samples(incarnation: Incarnation, paths: Iterable[Path], shift: float) -> Iterator[TelemetrySample]:
    start = incarnation.parts[0].start
    for (device, at), group in groupby(telemetry_in(paths), key=lambda value: (value.device, value.time)):
        found = {value.quantity: cast(Telemetry, value.value) for value in group}
        yield TelemetrySample(at - start.at + start.wall + shift, incarnation.host, device, found)

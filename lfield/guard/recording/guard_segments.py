"""Reads the ring of a guard: its segments with their records, and the telemetry of its devices."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec

from lfield.errors import RecordingError
from lfield.guard.recording.guard_records import (
    GuardRecord,
    Pulses,
    SegmentStart,
    TelemetryRecord,
    decode_record,
)
from lfield.guard.recording.guard_rings import RECORDS
from lfield.manifest import DeviceValue
from lfield.recording.folders import guard_folders, segments_of
from lfield.recording.segments import SegmentEnd, SegmentReader
from lfield.text.input_files import error_reason

#: The reason why a file without a record is of no use.
NO_RECORD = "it has no record"
_DAMAGED = "it has a record that is damaged or of another version of lfield"


class GuardSegment(msgspec.Struct, frozen=True):
    """One file of a ring. `start` is None if not even its first record is complete; `end` states the end of
    the readable part, and the reason.
    """

    path: Path
    start: SegmentStart | None
    records: list[GuardRecord]
    end: SegmentEnd

    def follows(self, before: GuardSegment | None) -> bool:
        """Whether this segment continues a complete segment of the same guard."""
        if before is None or before.start is None or self.start is None or before.end.reason:
            return False
        return before.start.guard == self.start.guard and before.start.number + 1 == self.start.number


class TelemetryValue(NamedTuple):
    """A telemetry value that has changed; `time` is monotonic, `wall_time` is since 1970, in seconds.

    `unit` is the unit in the manifest.
    """

    time: float
    device: str
    quantity: str
    value: DeviceValue
    unit: str
    wall_time: float


def rings_in(folder: Path) -> dict[str, list[Path]]:
    """The rings of the guards in the folder of an incarnation, by their first devices; oldest file first."""
    rings = {device: segments_of(path, RECORDS) for device, path in guard_folders(folder).items()}
    return {device: paths for device, paths in rings.items() if paths}


def guard_problems(folder: Path) -> list[str]:
    """The unreadable parts of the recordings of guards in the folder of an incarnation, a sentence each."""
    return [
        f"{segment.path.relative_to(folder)}: {segment.end.reason or NO_RECORD}"
        for paths in rings_in(folder).values()
        for segment in read_segments(paths)
        if segment.end.reason or segment.start is None
    ]


def read_segments(paths: Iterable[Path]) -> Iterator[GuardSegment]:
    """The segments in these files, in this order. An unreadable segment has no record."""
    for path in paths:
        try:
            yield read_segment(path)
        except RecordingError as error:
            yield GuardSegment(path, None, [], SegmentEnd(0, str(error)))


def read_segment(path: Path) -> GuardSegment:
    """One file. Raises RecordingError for a file that is no segment, or that has another format."""
    try:
        with path.open("rb") as stream:
            reader = SegmentReader(stream)
            if reader.problem:
                raise RecordingError(reader.problem)
            records = [_decoded(record) for record in reader]
    except OSError as error:
        raise RecordingError(f"it cannot be read: {error_reason(error)}") from None
    start = records[0] if records else None
    if start is not None and not isinstance(start, SegmentStart):
        raise RecordingError("it is not the recording of a guard")
    if start is not None and not all(_is_valid(start, record) for record in (*_values_at(start), *records)):
        raise RecordingError(_DAMAGED)
    return GuardSegment(path, start, records[1:], reader.end)


def _decoded(record: bytes) -> GuardRecord:
    try:
        return decode_record(record)
    except (msgspec.MsgspecError, UnicodeDecodeError):
        raise RecordingError(_DAMAGED) from None


def _is_valid(start: SegmentStart, record: GuardRecord) -> bool:
    """Whether pulses can be decoded, and telemetry is from a device of the guard."""
    if isinstance(record, Pulses):
        return math.isfinite(record.start) and len(record.steps) % 2 == 0
    if not isinstance(record, TelemetryRecord):
        return True
    devices = start.state.devices
    known = devices[record.device].manifest.telemetry if 0 <= record.device < len(devices) else []
    return all(0 <= at < len(known) for at in record.values)


def telemetry_in(paths: Iterable[Path]) -> Iterator[TelemetryValue]:
    """The telemetry in the files of one ring; if earlier files are missing, it begins with the values at the
    start of the first file.

    Raises RecordingError.
    """
    before: GuardSegment | None = None
    for segment in read_segments(paths):
        start = segment.start
        if start is None:
            continue
        for values in () if segment.follows(before) else _values_at(start):
            yield from _values(start, values)
        for record in segment.records:
            if isinstance(record, TelemetryRecord):
                yield from _values(start, record)
        before = segment


def _values_at(start: SegmentStart) -> Iterator[TelemetryRecord]:
    """The values at the start of a segment."""
    return (TelemetryRecord(start.monotonic, device, values) for device, values in enumerate(start.values))


def _values(start: SegmentStart, record: TelemetryRecord) -> Iterator[TelemetryValue]:
    device = start.state.devices[record.device]
    wall_time = start.wall_time + record.time - start.monotonic
    for at, value in record.values.items():
        quantity = device.manifest.telemetry[at]
        yield TelemetryValue(record.time, device.name, quantity.name, value, quantity.unit, wall_time)

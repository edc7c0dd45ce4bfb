"""Recorded telemetry, notes and foreign control of a guard, and their reader."""

from __future__ import annotations

import math

from recorded_guards import RecordedGuard

from lfield.guard.messages import Note, TelemetrySnapshot
from lfield.guard.recording import guard_inputs as inputs
from lfield.guard.recording.guard_recorder import MOST_EARLY, TELEMETRY_INTERVAL
from lfield.guard.recording.guard_records import ControlRecord, NoteRecord, SegmentStart, changed_values
from lfield.guard.recording.guard_segments import telemetry_in
from lfield.manifest import Observation


def observe(guard, seconds, is_foreign=False, **values):
    """The device reports these values `seconds` after the previous report."""
    guard.clock.advance(seconds)
    now = guard.clock.monotonic()
    observed = {name: Observation(value, now - 0.01) for name, value in values.items()}
    guard.recorder.on_snapshot(TelemetrySnapshot("a.arm", observed, now, is_foreign))


def values_in(paths):
    return [(value.quantity, value.value) for value in telemetry_in(paths)]


def test_only_changes_are_recorded_at_most_ten_per_second(tmp_path):
    guard = RecordedGuard()
    observe(guard, 1.0, height=1.0, mode="idle")
    for _ in range(20):
        observe(guard, TELEMETRY_INTERVAL / 4, height=2.0, mode="idle")
    observe(guard, TELEMETRY_INTERVAL / 4, height=1.0)
    guard.recorder.close()
    paths = guard.ring.stored(tmp_path)
    assert values_in(paths) == [("height", 1.0), ("mode", "idle"), ("height", 2.0), ("height", 1.0)]


def test_pending_value_is_recorded_at_close(tmp_path):
    guard = RecordedGuard()
    observe(guard, 1.0, height=1.0)
    observe(guard, 0.01, height=3.0)
    guard.recorder.close()
    assert values_in(guard.ring.stored(tmp_path))[-1] == ("height", 3.0)


def test_recorded_value_has_unit_and_both_times(tmp_path):
    guard = RecordedGuard(start=500.0)
    observe(guard, 1.0, height=1.0)
    (value,) = telemetry_in(guard.ring.stored(tmp_path))
    assert value == (500.99, "a.arm", "height", 1.0, "m", 500.99)


def test_each_segment_starts_with_the_last_values(tmp_path):
    guard = RecordedGuard(limit=1)
    observe(guard, 1.0, height=1.0, mode="idle")
    guard.handle(inputs.SafeStateRequested("a.arm", "an operator"))
    observe(guard, 1.0, height=2.0)
    paths = guard.ring.stored(tmp_path)
    assert values_in(paths) == [("height", 1.0), ("mode", "idle"), ("height", 2.0)]
    assert values_in(paths[-1:]) == values_in(paths)


def test_notes_and_foreign_control_are_recorded():
    guard = RecordedGuard()
    guard.recorder.on_note(Note("a.arm", "a note", "code", "warning"))
    observe(guard, 1.0, is_foreign=True)
    observe(guard, 1.0, is_foreign=True)
    assert guard.records[-2:] == [
        NoteRecord(1000.0, "a.arm", "a note", "code", "warning"),
        ControlRecord(1001.0, 0, True),
    ]


def test_early_records_follow_the_segment_start():
    guard = RecordedGuard(is_open=False)
    for _ in range(MOST_EARLY + 5):
        guard.recorder.on_note(Note("a.arm", "a note"))
    assert guard.ring.files == []
    guard.open()
    start, *notes = guard.records[:-1]
    assert isinstance(start, SegmentStart)
    assert len(notes) == MOST_EARLY


def test_repeated_nan_is_no_change():
    assert changed_values({0: math.nan, 1: 1.0}, {0: math.nan, 1: 1.0}) == {}
    assert changed_values({0: 1.0, 1: True}, {0: math.nan, 1: 1, 2: None}) == {0: math.nan, 1: 1, 2: None}

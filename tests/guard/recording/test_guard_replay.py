"""A replay of a guard's recording makes identical decisions, or reports the first difference."""

from __future__ import annotations

import math
import random
from io import BytesIO

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorded_guards import FOLDER, RandomInputs, RecordedGuard

from lfield.errors import RecordingError
from lfield.guard.core import GuardCore
from lfield.guard.effects import Exit
from lfield.guard.messages import GuardCall
from lfield.guard.recording import guard_inputs as inputs
from lfield.guard.recording.guard_records import (
    InputRecord,
    Pulses,
    decode_record,
    framed,
)
from lfield.guard.recording.guard_replay import replay_guard
from lfield.guard.recording.guard_segments import read_segment, rings_in, telemetry_in
from lfield.guard.recording.heartbeat_pulses import MOST_PULSES, PulseCollector, pulses_in
from lfield.recording.folders import guard_folder
from lfield.recording.segments import MAGIC, SegmentReader, frame


@settings(max_examples=150, deadline=None)
@given(st.integers(), st.sampled_from([None, 1, 6000]), st.floats(0.0, 1e7))
def test_replay_of_random_inputs_makes_identical_decisions(tmp_path_factory, seed, limit, start):
    guard = RandomInputs(seed, RecordedGuard(limit, start)).run(60)
    guard.recorder.close()
    result = replay_guard(guard.ring.stored(tmp_path_factory.mktemp("ring")))
    assert (result.differences, result.first, result.cut, result.missing) == (0, None, {}, [])
    assert result.digests >= 60
    assert limit != 1 or len(guard.ring.files) > 10


def test_each_segment_is_replayed_without_the_earlier_ones(tmp_path):
    guard = RandomInputs(7, RecordedGuard(limit=5000)).run(400)
    guard.recorder.close()
    paths = guard.ring.stored(tmp_path)
    assert len(paths) > 4
    for first in range(len(paths)):
        result = replay_guard(paths[first:])
        assert (result.differences, result.digests > 0) == (0, True)


def test_first_difference_has_time_input_and_both_decisions(tmp_path, monkeypatch):
    guard = RecordedGuard()
    guard.call(1, "go", 1.0)
    guard.clock.advance(0.25)
    guard.handle(inputs.TimerExpired())
    guard.clock.advance(0.25)
    guard.handle(inputs.HostGone("the host is gone"))
    guard.recorder.close()
    paths = guard.ring.stored(tmp_path)
    monkeypatch.setattr(GuardCore, "tick", lambda core: [Exit(3)])
    result = replay_guard(paths)
    assert result.first.path == paths[0]
    # The first input is BusOpened, which does not use the changed method.
    assert (result.first.time, result.first.input[:12], result.first.replayed[:7]) == (
        1000.0,
        "CallReceived",
        "Exit(3)",
    )
    assert result.first.recorded == "Execute(1)"
    assert (result.differences, result.digests) == (3, 4)


def test_changed_state_is_found_at_the_next_segment(tmp_path, monkeypatch):
    guard = RecordedGuard(limit=1)
    guard.clock.advance(0.01)
    guard.handle(inputs.SafeStateRequested("a.arm", "an operator", lock=True))
    guard.handle(inputs.StopCleared())
    guard.recorder.close()
    paths = guard.ring.stored(tmp_path)
    monkeypatch.setattr(GuardCore, "clear_stop", lambda core: [])
    result = replay_guard(paths)
    assert result.differences == 1
    assert result.first.input == f"the state at the start of {paths[-1].name}"


def test_call_accepted_in_one_segment_may_start_in_the_next(tmp_path):
    guard = RecordedGuard(limit=1)
    guard.call(1, "go", 1.0)
    (call,) = (effect.call for effect in guard.call(2, "grip"))
    guard.clock.advance(0.6)
    assert guard.core.start_call(call) != ""
    guard.recorder.close()
    paths = guard.ring.stored(tmp_path)
    assert replay_guard(paths[-2:]).differences == 0
    assert [len(read_segment(path).start.unstarted) for path in paths[-2:]] == [2, 1]


def test_truncated_file_is_replayed_up_to_its_end(tmp_path):
    guard = RandomInputs(3, RecordedGuard()).run(5)
    guard.recorder.close()
    (path,) = guard.ring.stored(tmp_path)
    data = path.read_bytes()
    replayed, previous = replay_guard([path]), 0
    ends = {len(MAGIC)}
    for record in SegmentReader(BytesIO(data)):
        ends.add(max(ends) + len(frame(record)))
    first = sorted(ends)[1]
    # A truncated first record is unusable, and it is long: only some of its truncations are tested.
    for size in [*range(10), *range(10, first, 37), *range(first - 3, len(data))]:
        path.write_bytes(data[:size])
        result = replay_guard([path])
        assert previous <= result.digests <= replayed.digests
        assert result.differences == 0
        assert bool(result.cut) == (size > len(MAGIC) and size not in ends)
        assert bool(result.missing) == (size < first)
        previous = result.digests
    assert previous == replayed.digests - 1


def test_replay_of_a_damaged_file_ends_at_the_damage(tmp_path):
    guard = RandomInputs(4, RecordedGuard()).run(12)
    guard.recorder.close()
    (path,) = guard.ring.stored(tmp_path)
    data = path.read_bytes()
    replayed = replay_guard([path]).digests
    for at in range(len(MAGIC), len(data), 23):
        path.write_bytes(data[:at] + bytes([data[at] ^ 0x41]) + data[at + 1 :])
        result = replay_guard([path])
        assert result.digests < replayed
        assert list(result.cut) == [path]


def changed(rng, value):
    """The value with one random change in it."""
    if isinstance(value, list | dict) and value:
        places = list(value) if isinstance(value, dict) else range(len(value))
        place = rng.choice(places)
        value[place] = changed(rng, value[place])
        return value
    if isinstance(value, int) and rng.random() < 0.5:
        return value + rng.choice([1, -1, 1000])
    return rng.choice([None, -1, 1 << 40, "x", b"x", [], {}, [1], True, float("nan")])


@pytest.mark.parametrize("seed", range(60))
def test_changed_record_with_a_valid_checksum_does_not_break_the_replay(tmp_path, seed):
    rng = random.Random(seed)
    guard = RandomInputs(4, RecordedGuard()).run(12)
    guard.recorder.close()
    (path,) = guard.ring.stored(tmp_path)
    records = list(SegmentReader(BytesIO(path.read_bytes())))
    place = rng.randrange(len(records))
    records[place] = msgspec.msgpack.encode(changed(rng, msgspec.msgpack.decode(records[place])))
    path.write_bytes(MAGIC + b"".join(map(frame, records)))
    result = replay_guard([path])
    assert result.digests or result.missing
    assert [value.device for value in telemetry_in([path])].count("") == 0


@pytest.mark.parametrize("pulses", [Pulses(math.nan, []), Pulses(math.inf, [0, 0]), Pulses(1.0, [0])])
def test_invalid_pulses_are_refused(tmp_path, pulses):
    guard = RandomInputs(4, RecordedGuard()).run(12)
    guard.recorder.close()
    (path,) = guard.ring.stored(tmp_path)
    path.write_bytes(path.read_bytes() + framed(pulses))
    with pytest.raises(RecordingError):
        read_segment(path)
    assert replay_guard([path]).missing == [path]


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (b"no recording", "is no recording"),
        (MAGIC[:-1] + bytes([MAGIC[-1] + 1]), "a newer lfield"),
        (MAGIC[:-1] + bytes([MAGIC[-1] - 1]), "the lfield that recorded it"),
        (MAGIC + frame(b"\x93\x00\x01\xc0"), "damaged or of another version"),
        (MAGIC + framed(Pulses(0.0, [])), "is not the recording of a guard"),
    ],
)
def test_file_that_is_no_guard_recording_is_refused(tmp_path, data, text):
    path = tmp_path / "guard-a-000001.lfrec"
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=text):
        read_segment(path)
    result = replay_guard([path])
    assert result.missing == [path]
    assert text in result.cut[path]


def test_missing_file_is_named(tmp_path):
    path = tmp_path / "guard-a-000001.lfrec"
    assert replay_guard([path]).missing == [path]


def test_unreadable_file_does_not_hide_the_others(tmp_path):
    guard = RandomInputs(4, RecordedGuard()).run(12)
    guard.recorder.close()
    (path,) = guard.ring.stored(tmp_path)
    other = tmp_path / "guard-a-000000.lfrec"
    other.write_bytes(MAGIC[:-1] + b"\x7f")
    replayed, result = replay_guard([path]), replay_guard([other, path])
    assert result.digests == replayed.digests > 0
    assert list(result.cut) == [other]


def test_rings_of_a_folder_are_found_by_device(tmp_path):
    for device, numbers in {"b.fc": (2, 1), "ä/x": (1,), "none": ()}.items():
        guard_folder(tmp_path, device).mkdir()
        for number in numbers:
            (guard_folder(tmp_path, device) / f"guard-{number:06d}.lfrec").touch()
    (tmp_path / "core-000001.lfrec").touch()
    found = {device: [path.name for path in paths] for device, paths in rings_in(tmp_path).items()}
    assert found == {"b.fc": ["guard-000001.lfrec", "guard-000002.lfrec"], "ä/x": ["guard-000001.lfrec"]}


def test_secrets_of_a_binding_are_not_recorded():
    guard = RecordedGuard()
    start = guard.records[0]
    assert b"hunter2" not in guard.ring.files[0]
    assert (start.host, start.incarnation, start.run) == ("north", "1f3a9c02", "run 7")
    assert FOLDER.endswith(start.incarnation)
    (arm, eye) = start.devices
    assert (arm.name, arm.endpoint, arm.options) == ("a.arm", "tcp:10.0.0.7:5760", {"system": 7})
    assert (eye.name, eye.safe_state, eye.manifest) == ("a.eye", "", bytes(32))


# --- heartbeats ---------------------------------------------------------------------------------------------


@settings(deadline=None)
@given(st.lists(st.tuples(st.floats(0.0, 1e9), st.floats(-1.0, 1.0), st.booleans()), max_size=30))
def test_pulses_are_stored_exactly_or_refused(pulses):
    collector, added, read = PulseCollector(), [], []
    for time, delay, is_timer in sorted(pulses):
        event = inputs.TimerExpired() if is_timer else inputs.HostBeat(time - delay)
        if collector.add(time, event):
            added.append((time, event))
        if collector.is_full:
            read += pulses_in(collector.record())
    if (rest := collector.record()) is not None:
        read += pulses_in(rest)
    assert read == added


def test_heartbeats_of_a_real_clock_share_one_record():
    guard = RecordedGuard(start=39243.54424449)
    for _ in range(MOST_PULSES):
        # Rounded as time.clock_gettime rounds seconds and nanoseconds.
        guard.clock.now = round(guard.clock.now + 0.0501, 9)
        guard.handle(inputs.HostBeat(round(guard.clock.now - 0.00013, 9)))
    _, opened, pulses = guard.records
    assert isinstance(opened, InputRecord)
    assert len(list(pulses_in(pulses))) == MOST_PULSES
    assert len(framed(pulses)) / MOST_PULSES < 13


def test_recorded_call_keeps_its_argument_types():
    call = GuardCall(1, "a.arm", "go", [1, 1.0, True, "x", [1.0]], 0.1, float("inf"))
    record = decode_record(framed(InputRecord(0.1, inputs.CallReceived(call)))[8:])
    assert repr(record.input.call) == repr(call)

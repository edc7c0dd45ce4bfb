"""Recordings that are cut, damaged or hostile: fewer turns and a reason, or RecordingError."""

from __future__ import annotations

import json
import os
import pickle

import msgspec
import pytest
from recorded_teams import content, run_recorded, walk_mission

from lfield.errors import RecordingError
from lfield.guard.recording.guard_segments import read_segment
from lfield.host.inputs import BatchDurable, DeviceAnswered
from lfield.host.recording import flight_recorder, host_records
from lfield.host.recording.host_records import CheckpointRecord, IdleTurn, TurnRecord
from lfield.recording.segments import MAGIC, frame
from lfield.replay.host_recording import HostRecording
from lfield.replay.host_replay import HostReplay
from lfield.replay.recording_files import load_incarnation
from lfield.replay.team_check import check_part


@pytest.fixture(scope="module")
def team(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(flight_recorder, "CHECKPOINT_INTERVAL", 0.6)
        return run_recorded(walk_mission(tmp_path_factory.mktemp("walk")), 1.5)


def read_all(path) -> int:
    """The turns that a file has; each record is decoded."""
    return sum(1 for part in load_incarnation(path.parent).parts for _ in part.turns_from(0))


def test_a_file_cut_at_any_byte_has_the_turns_of_its_complete_frames(team, tmp_path):
    path = tmp_path / "core-000001.lfrec"
    data = MAGIC + b"".join(map(frame, team.hosts[0][1][:4]))
    path.write_bytes(data)
    all_turns, last = read_all(path), 0
    for size in range(len(data)):
        path.write_bytes(data[:size])
        try:
            loaded = load_incarnation(tmp_path)
        except RecordingError:
            assert last == 0
            continue
        turns = sum(part.turns for part in loaded.parts)
        assert last <= turns <= all_turns
        assert loaded.problems
        last = turns
    assert 0 < last < all_turns


def test_zeros_after_the_last_frame_are_a_cut(team, tmp_path):
    """As after a power failure. The file is much larger than its frames, and is not read completely."""
    path = tmp_path / "core-000001.lfrec"
    path.write_bytes(MAGIC + b"".join(map(frame, team.hosts[0][1][:4])))
    turns = read_all(path)
    os.truncate(path, 1 << 25)
    assert read_all(path) == turns
    assert load_incarnation(tmp_path).losses == ()
    with path.open("r+b") as stream:
        stream.seek(-1, os.SEEK_END)
        stream.write(b"x")
    assert read_all(path) == turns
    assert len(load_incarnation(tmp_path).losses) == 1


def test_a_huge_invalid_file_is_refused_at_once(tmp_path):
    for name in ("core-000001.lfrec", "guard-000001.lfrec"):
        (tmp_path / name).touch()
        os.truncate(tmp_path / name, 1 << 40)
    with pytest.raises(RecordingError):
        load_incarnation(tmp_path)
    with pytest.raises(RecordingError):
        read_segment(tmp_path / "guard-000001.lfrec")


def test_a_flipped_byte_ends_the_file_or_is_refused(team, tmp_path):
    path = tmp_path / "core-000001.lfrec"
    data = bytearray(MAGIC + b"".join(map(frame, team.hosts[0][1][:3])))
    path.write_bytes(data)
    turns = read_all(path)
    for place in range(len(data)):
        data[place] ^= 0x55
        path.write_bytes(data)
        data[place] ^= 0x55
        try:
            loaded = load_incarnation(tmp_path)
        except RecordingError:
            continue
        assert sum(part.turns for part in loaded.parts) < turns
        assert loaded.problems


def test_a_flipped_byte_with_a_valid_checksum_causes_an_error_or_a_difference(team):
    """The checksum is not the only protection: an attacker may compute it again."""
    frames = list(team.hosts[0][1])
    for number in range(3):
        data = frames[number]
        for place in range(0, len(data), 1 + len(data) // 100):
            changed = bytearray(data)
            changed[place] ^= 0x55
            replay_hostile([*frames[:number], bytes(changed), *frames[number + 1 :]], team)


def replay_hostile(frames, team) -> str:
    """Replay frames; returns why that failed, '' if it did not."""
    try:
        recording = HostRecording(frames)
        check_part(recording, HostReplay(recording, team.mission))
    except RecordingError as error:
        return str(error)
    return ""


def checkpoint_of(team) -> CheckpointRecord:
    recording = HostRecording(team.hosts[0][1])
    number = next(place for place, each in enumerate(recording.frames) if each.header.kind == b"C")
    (record,) = host_records.decode_frame(recording.frames[number].data)
    assert isinstance(record, CheckpointRecord)
    return record


@pytest.fixture(scope="module")
def checkpoint(team):
    return checkpoint_of(team)


def with_snapshot(checkpoint, snapshot: bytes) -> list[bytes]:
    return [content([msgspec.structs.replace(checkpoint, snapshot=snapshot)], b"C")]


def changed_state(checkpoint, hostile) -> bytes:
    """The snapshot, with a value in place of the first state of a part."""
    sizes, states, objects, rng = msgspec.msgpack.decode(checkpoint.snapshot)
    place = next(place for place, state in enumerate(states) if state and isinstance(state[0], str))
    states[place][1] = hostile
    return msgspec.msgpack.encode([sizes, states, objects, rng])


def nested(depth: int, kind: str = "tuple"):
    found: list = []
    for _ in range(depth):
        found = ["tuple", kind, [found]]
    return found


HOSTILE_VALUES = {
    "a function of os": ["type", "os:system"],
    "a class of builtins": ["tuple", "builtins:list", [1]],
    "through an import of ours": ["type", "lfield.cli.main:sys.modules"],
    "a class of lfield that is no tuple": ["tuple", "lfield.host.core:HostCore", [1]],
    "an exception": ["enum", "lfield.errors:RecordingError", "x"],
    "a private method": ["method", ["part", 0], "__init_subclass__"],
    "a method of nothing": ["method", None, "run"],
    "a part that does not exist": ["part", 1 << 40],
    "a negative part": ["part", -1 << 40],
    "an object that does not exist": ["object", 1 << 40],
    "an unknown word": ["eval", "1"],
    "an empty list": [],
    "bytes of another size": ["bytes", "Q", b"123"],
    "bytes of an unknown format": ["bytes", "what", b"12345678"],
    "a reading that does not exist": ["reading", 1 << 40],
}


@pytest.mark.parametrize("name", HOSTILE_VALUES)
def test_a_snapshot_with_a_hostile_value_is_refused(team, checkpoint, name):
    snapshot = changed_state(checkpoint, HOSTILE_VALUES[name])
    assert replay_hostile(with_snapshot(checkpoint, snapshot), team)


HOSTILE_OBJECTS = {
    "os": [["instance", "os:_Environ", []]],
    "a class that is no data": [["instance", "lfield.cli.main:Path", []]],
    "a struct without its fields": [["instance", "lfield.wire.messages:Hello", []]],
    "a struct with another field": [["instance", "lfield.wire.messages:Hello", ["shell", "id"]]],
    "an enum": [["instance", "lfield.host.recording.recorded_environment:Question", []]],
    "a block of 8 TB": [["block", "", 1 << 40, 1 << 40, 0]],
    "a block of a negative size": [["block", "", -8, 1 << 20, 0]],
    "a block of text": [["block", "abc", 8, 8, 0]],
    "a block with two fields": [["block", ""]],
    "no row": [7],
    "an empty row": [[]],
    "a dict with half a pair": [["dict", [1]]],
    "a dict whose key is a list": [["list", []], ["dict", [["object", -1], 1]]],
    "structs in a circle": [["instance", "lfield.host.inputs:DeviceAnswered", ["number", ["object", -1]]]],
    "a special attribute": [
        ["instance", "lfield.host.context:HostContext", ["__class__", ["type", "lfield.host.core:HostCore"]]]
    ],
}


@pytest.mark.parametrize("name", HOSTILE_OBJECTS)
def test_a_snapshot_with_a_hostile_object_is_refused(team, checkpoint, name):
    sizes, states, objects, rng = msgspec.msgpack.decode(checkpoint.snapshot)
    text = json.dumps(HOSTILE_OBJECTS[name]).replace("-1]", f"{len(objects)}]")
    snapshot = msgspec.msgpack.encode([sizes, states, [*objects, *json.loads(text)], rng])
    assert replay_hostile(with_snapshot(checkpoint, snapshot), team)


def test_a_failure_of_the_core_is_a_difference(team):
    """An input that no host could have received makes the core fail."""
    entry = DeviceAnswered(7, None, ("arm",))
    turns = [TurnRecord(9.0, BatchDurable(1 << 40)), TurnRecord(9.0, entry)]
    frames = [*team.hosts[0][1][:2], content(turns, b"T", 2)]
    recording = HostRecording(frames)
    result = check_part(recording, HostReplay(recording, team.mission))
    assert result.differences == 1


@pytest.mark.parametrize("snapshot", [
    b"", b"\xc1", b"\x90", msgspec.msgpack.encode({}), pickle.dumps(OSError()), b"\xdd\xff\xff\xff\xff",
    b"\x91" * 100_000, b"\x91" * 1000 + b"\xc0",
], ids=lambda data: f"{len(data)} bytes {data[:4].hex()}")  # fmt: skip
def test_an_invalid_snapshot_is_refused(team, checkpoint, snapshot):
    assert replay_hostile(with_snapshot(checkpoint, snapshot), team)


@pytest.mark.parametrize("depth", [200, 900, 5000])
def test_a_deep_snapshot_is_refused(team, checkpoint, depth):
    try:
        snapshot = changed_state(checkpoint, nested(depth))
    except RecursionError:  # the encoder refuses it: encoded by hand
        snapshot = b"\x94" + b"\x93\xa5tuple\xa5tuple\x91" * depth + b"\xc0"
    replay_hostile(with_snapshot(checkpoint, snapshot), team)


def test_a_frame_that_decompresses_to_more_than_the_limit_is_refused(team, monkeypatch):
    bomb = content([IdleTurn(1.0)] * 200_000, b"T", 200_000)
    assert len(bomb) < 1 << 16
    monkeypatch.setattr(host_records, "MAX_FRAME", 1 << 20)
    with pytest.raises(RecordingError):
        host_records.decode_frame(bomb)
    with pytest.raises(RecordingError):
        content([IdleTurn(1.0)] * 200_000, b"T", 200_000)


def test_a_header_with_a_wrong_turn_count_is_handled(team):
    frames = list(team.hosts[0][1][:2])
    for turns in (0, 1 << 31):
        replay_hostile([*frames, content([IdleTurn(9.0)], b"T", turns)], team)


@pytest.mark.parametrize("records", [[], [1], [[3]], [[99, 1.0]], [[3, "soon"]], [[1]], {"a": 1}], ids=str)
@pytest.mark.parametrize("kind", [b"S", b"C", b"T", b"X"])
def test_a_frame_of_invalid_records_is_refused_or_has_no_turns(team, records, kind):
    import zlib

    data = content([], kind)[:13] + zlib.compress(msgspec.msgpack.encode(records))
    replay_hostile([data], team)
    replay_hostile([team.hosts[0][1][0], data], team)

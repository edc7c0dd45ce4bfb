"""Export of a stream to MCAP, read with the package `mcap`."""

from __future__ import annotations

import io
import json
import math

import jsonschema
import pytest
from mcap.reader import make_reader
from sample_flight import FRAMED, START, UNFRAMED, Team, by_topic, flight, mcap_bytes, readable

from lfield.export.export_input import NO_INFO, StreamNotice
from lfield.export.mcap_writer import END_WITHOUT_SUMMARY, McapRecording
from lfield.export.scene import MapPoint
from lfield.export.vehicle_track import MAX_POINTS, Track
from lfield.wire import events


@pytest.fixture(scope="module")
def whole() -> bytes:
    return mcap_bytes(flight())


def test_each_message_is_in_a_channel_of_its_kind(whole):
    found = {topic: len(messages) for topic, messages in by_topic(whole).items()}
    assert found == {
        "/agents/pilot": 1,
        "/devices/lead/fc": 1,
        "/devices/lead/fc/fix": 1,
        "/devices/lead/fc/track": 1,
        "/devices/wing/fc": 2,
        "/devices/wing/fc/fix": 2,
        "/devices/wing/fc/track": 2,
        "/events": 11,
        "/hops": 3,
        "/links/alpha/bravo": 1,
        "/log": 2,
        "/tf": 4,
    }


def test_every_message_is_valid_by_the_schema_of_its_channel(whole):
    reader = make_reader(io.BytesIO(whole))
    validators: dict[int, jsonschema.Draft202012Validator] = {}
    names = set()
    for schema, channel, message in reader.iter_messages():
        assert schema is not None
        assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
        if schema.id not in validators:
            content = json.loads(schema.data)
            jsonschema.Draft202012Validator.check_schema(content)
            validators[schema.id] = jsonschema.Draft202012Validator(content)
        validator = validators[schema.id]
        validator.validate(json.loads(message.data))
        # A viewer shows only the fields that are in the schema.
        assert json.loads(message.data).keys() <= validator.schema["properties"].keys()
        names.add(schema.name)
    foxglove = {"LocationFix", "FrameTransforms", "SceneUpdate", "Log"}
    own = {"lfield.Event", "lfield.Link", "lfield.Activity", "lfield.lead.fc", "lfield.wing.fc"}
    assert names == {f"foxglove.{name}" for name in foxglove} | own


def test_telemetry_has_units_and_meanings_of_the_manifest(whole):
    summary = make_reader(io.BytesIO(whole)).get_summary()
    assert summary is not None
    channel = next(c for c in summary.channels.values() if c.topic == "/devices/lead/fc")
    assert channel.metadata == {"position": "m", "attitude": "rad", "heading": "rad", "groundSpeed": "m/s"}
    fields = json.loads(summary.schemas[channel.schema_id].data)["properties"]
    assert fields["groundSpeed"] == {"type": "number", "description": "over ground [m/s]", "unit": "m/s"}
    assert fields["position"]["items"] == {"type": "number"}
    assert (fields["armed"], fields["satellites"]) == ({"type": "boolean"}, {"type": "integer"})


def test_hop_is_an_arrow_and_the_arrow_of_a_failed_hop_is_deleted(whole):
    (time, first), (_, second), (_, third) = by_topic(whole)["/hops"]
    assert time == 0.2
    entity = first["entities"][0]
    arrow = entity["arrows"][0]
    assert arrow["pose"]["position"] == {"x": 0.0, "y": 0.0, "z": 10.0}
    assert arrow["shaft_length"] + arrow["head_length"] == pytest.approx(30.0)
    # The x axis of the arrow is rotated to y, which is north in the map.
    turned = [0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)]
    assert list(arrow["pose"]["orientation"].values()) == pytest.approx(turned)
    assert entity["texts"][0]["text"] == "pilot: wing.climb"
    assert third["deletions"][0]["id"] == second["entities"][0]["id"] != entity["id"]


def test_pose_is_east_north_up_and_the_fix_is_relative_to_the_origin(whole):
    found = by_topic(whole)
    transforms = [message["transforms"][0] for _, message in found["/tf"]]
    assert [each["child_frame_id"] for each in transforms] == ["team", "lead.fc", "wing.fc", "wing.fc"]
    assert transforms[3]["translation"] == {"x": 4.0, "y": 31.0, "z": 12.0}
    assert all(each["parent_frame_id"] == "map" for each in transforms)
    _, fix = found["/devices/wing/fc/fix"][0]
    assert (fix["latitude"], fix["longitude"]) == (pytest.approx(47.00027, abs=2e-5), 8.0)
    assert fix["altitude"] == pytest.approx(410.0)


@pytest.mark.parametrize(
    ("heading", "x_axis"),
    [(0.0, (0.0, 1.0)), (math.pi / 2, (1.0, 0.0)), (math.pi, (0.0, -1.0)), (-math.pi / 2, (-1.0, 0.0))],
)
def test_pose_is_turned_to_the_heading(heading, x_axis):
    sample = Team().sample(0.0, "a", "lead.fc", position=[0.0, 0.0, 0.0], attitude=[0.0, 0.0, heading])
    (_, _), (_, pose) = by_topic(mcap_bytes([sample]))["/tf"]
    x, y, z, w = pose["transforms"][0]["rotation"].values()
    assert (x, y) == (pytest.approx(0.0), pytest.approx(0.0))
    assert [1 - 2 * z * z, 2 * w * z] == pytest.approx(x_axis, abs=1e-9)


def test_global_positions_are_relative_to_the_first_one_without_a_frame():
    team = Team()
    stream = [
        # This position is relative to the home of the vehicle, not to the other vehicle.
        team.sample(0.0, "alpha", "lead.fc", position=[5.0, 5.0, -1.0]),
        team.sample(0.5, "alpha", "lead.fc", globalPosition=[47.0, 8.0, 400.0]),
        team.sample(0.6, "bravo", "wing.fc", position=[0.0, 0.0, 0.0], globalPosition=[47.001, 8.0, 402.0]),
    ]
    poses = [m["transforms"][0] for _, m in by_topic(mcap_bytes(stream, UNFRAMED))["/tf"]]
    assert [pose["child_frame_id"] for pose in poses] == ["team", "lead.fc", "wing.fc"]
    assert poses[1]["translation"] == {"x": 0.0, "y": 0.0, "z": 0.0}
    assert poses[2]["translation"]["y"] == pytest.approx(111.2, abs=0.1)
    assert poses[2]["translation"]["z"] == pytest.approx(2.0)


def test_vehicle_without_a_global_position_is_shown_after_a_delay():
    team = Team()
    stream = [team.sample(t, "alpha", "lead.fc", position=[t, 0.0, 0.0]) for t in (0.0, 1.0, 3.0)]
    found = by_topic(mcap_bytes(stream, UNFRAMED))
    assert [time for time, _ in found["/tf"]] == [3.0, 3.0]
    assert "/devices/lead/fc/fix" not in found


def test_track_covers_the_whole_path_with_a_bounded_number_of_points():
    track = Track()
    for n in range(5000):
        track.add(MapPoint(float(n), math.sin(n), 5.0))
        assert len(track.points) <= MAX_POINTS
    assert (track.points[0]["x"], len(track.points) > MAX_POINTS // 4) == (0.0, True)
    assert track.points[-1]["x"] > 4900.0


def test_growing_track_is_drawn_once_a_second():
    team = Team()
    north = [min(n, 20) for n in range(41)]
    stream = [team.sample(n / 4, "alpha", "lead.fc", position=[x, 0.0, 0.0]) for n, x in enumerate(north)]
    drawings = by_topic(mcap_bytes(stream))["/devices/lead/fc/track"]
    assert [time for time, _ in drawings] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    _, last = drawings[-1]
    line = last["entities"][0]["lines"][0]["points"]
    assert [point["y"] for point in line] == [float(n) for n in range(21)]


def test_log_lines_have_levels_and_names(whole):
    team = Team()
    stream = [
        *flight(),
        team.event(2.0, "alpha", events.EventsDropped("left", 5)),
        StreamNotice(START + 3.0, "bravo", "unreachable: no link"),
    ]
    lines = [(m["name"], m["level"], m["message"]) for _, m in by_topic(mcap_bytes(stream))["/log"]]
    assert lines == [
        ("bravo/pilot", 2, "up, and away"),
        ("bravo", 3, "battery low"),
        ("alpha", 3, "5 events of kind 'left' left out: too frequent"),
        ("bravo", 3, "unreachable: no link"),
    ]


def test_mcap_event_has_its_host_and_cause(whole):
    arrival = next(m for _, m in by_topic(whole)["/events"] if m["kind"] == "came")
    expected = {"host": "bravo", "number": 1, "cause_host": "alpha", "cause_number": 3, "size": 600}
    assert arrival == arrival | expected


def test_values_that_are_invalid_in_json_and_unknown_quantities_are_exported():
    team = Team()
    nan = float("nan")
    stream = [
        team.sample(0.0, "alpha", "lead.fc", groundSpeed=nan, position=[1.0, nan, 0.0], mode="A"),
        team.sample(1.0, "alpha", "lead.fc", groundSpeed=2, mode=5, tilt=3),
        team.sample(2.0, "alpha", "lead.fc", tilt=3.5),
    ]
    data = mcap_bytes(stream)
    values = [message for _, message in by_topic(data)["/devices/lead/fc"]]
    head = {"host": "alpha", "silent": 0.1}
    # A numeric mode does not match the schema and is dropped.
    assert values == [
        {**head, "position": [1.0, None, 0.0], "mode": "A"},
        {**head, "groundSpeed": 2, "tilt": 3},
        {**head, "tilt": 3.5},
    ]
    summary = make_reader(io.BytesIO(data)).get_summary()
    assert summary is not None
    assert [c.topic for c in summary.channels.values()] == ["/devices/lead/fc"] * 3


def test_quantities_with_standard_names_are_found_without_mission_files():
    found = by_topic(mcap_bytes(flight(), NO_INFO))
    assert len(found["/hops"]) == 0
    stream = [Team().sample(t, "alpha", "x.fc", globalPosition=[47.0, 8.0, 1.0]) for t in (0.0, 1.0)]
    assert len(by_topic(mcap_bytes(stream, NO_INFO))["/devices/x/fc/fix"]) == 2


def test_number_of_channels_is_bounded(monkeypatch):
    monkeypatch.setattr("lfield.export.mcap_writer.MAX_CHANNELS", 5)
    out = io.BytesIO()
    recording = McapRecording(NO_INFO, out)
    for n in range(9):
        recording.add(Team().sample(n, "alpha", f"d{n}.x", speed=1.0))
    recording.finish()
    assert (recording.channels, recording.messages, recording.dropped) == (5, 5, 4)
    assert len(by_topic(out.getvalue())) == 5


# --- unfinished files ---------------------------------------------------------------------------------------


def flushed_flight() -> tuple[bytes, list[tuple[int, int]]]:
    """A file that is flushed after each item, and its size and number of messages after each flush."""
    out = io.BytesIO()
    recording = McapRecording(FRAMED, out)
    marks = []
    for item in flight():
        recording.add(item)
        recording.flush()
        marks.append((len(out.getvalue()), recording.messages))
    return out.getvalue(), marks


def test_truncated_file_has_all_messages_flushed_before():
    data, marks = flushed_flight()
    for size in range(0, len(data), 31):
        assert readable(data[:size]) >= max((count for at, count in marks if at <= size), default=0)
    assert [readable(data[:at]) for at, _ in marks] == [count for _, count in marks]


def test_file_with_an_end_without_summary_is_complete():
    data, marks = flushed_flight()
    assert sum(map(len, by_topic(data + END_WITHOUT_SUMMARY).values())) == marks[-1][1]


def test_same_stream_gives_the_same_bytes(whole):
    assert mcap_bytes(flight()) == whole

"""Reports of a vehicle about its plans and mission targets, without a vehicle."""

from __future__ import annotations

import struct

import pytest
from pymavlink.generator.mavcrc import x25crc

from lfield_mavlink.geodesy import Place
from lfield_mavlink.link.dialect import Reader, dialect
from lfield_mavlink.monitors.mission_changes import MissionChanges, MissionTarget

HOME = Place(47.397742, 8.545594, 488.0)


def current(seq, total=4, mission=0, fence=0, rally=0):
    """MISSION_CURRENT as newer autopilots send it, with plan ids, decoded by the driver's reader."""
    payload = struct.pack("<HHBBIII", seq, total, 3, 1, mission, fence, rally).rstrip(b"\0") or b"\0"
    body = struct.pack("<BBBBBBHB", len(payload), 0, 0, 0, 1, 1, 42, 0) + payload
    crc = x25crc(body + bytes([dialect.MAVLink_mission_current_message.crc_extra])).crc
    (message,) = Reader().feed(b"\xfd" + body + struct.pack("<H", crc))
    assert (message.seq, message.total) == (seq, total)
    return message


def signs(*messages, **about):
    changes = MissionChanges()
    changes.on_checked(**about)
    return [changes.on_current(message) for message in messages]


def test_changed_item_count_or_plan_id_is_a_mission_change():
    assert signs(current(1), current(1), current(2), current(4)) == [False] * 4
    assert signs(current(1), current(1, total=5), current(1, total=5)) == [False, True, False]
    assert signs(current(1, mission=7), current(2, mission=7), current(2, mission=8)) == [False, False, True]
    assert signs(current(1, rally=7), current(1, rally=8)) == [False, True]
    assert signs(current(1, fence=7), current(1, fence=8)) == [False, False], (
        "a fence does not move the vehicle"
    )
    assert signs(current(3), current(0)) == [False, True], "PX4 begins a new mission with item 0"


def test_autopilot_without_item_count_gives_no_change():
    assert signs(current(1, total=0), current(2, total=0), current(3, total=0)) == [False] * 3


def test_curves_and_returns_are_checked_at_the_item_before_them():
    assert signs(current(1), current(1), current(2), curved=True)[1:] == [False, True]
    assert signs(current(1), current(2), current(3), current(4), returns=[4]) == [False, False, True, False]


@pytest.mark.parametrize(("name", "index", "sign"), [
    ("MIS_TOTAL", 65535, True), ("RALLY_TOTAL", 65535, True), ("MIS_TOTAL", 12, False),
    ("FENCE_TOTAL", 65535, False), ("WP_SPEED", 65535, False),
])  # fmt: skip
def test_unrequested_plan_counter_is_a_mission_change(name, index, sign):
    message = dialect.MAVLink_param_value_message(name.encode(), 3.0, 4, 1333, index)
    message.param_id = name
    assert MissionChanges().on_parameter(message) is sign


def target(north, east, altitude):
    there = HOME.shifted((north, east, 0.0))
    latitude, longitude = round(there.latitude * 1e7), round(there.longitude * 1e7)
    return dialect.MAVLink_position_target_global_int_message(
        0, 5, 0, latitude, longitude, altitude, *[0.0] * 8
    )


def test_mission_target_is_checked_against_the_limits():
    limits = MissionTarget(50.0, 20.0)
    assert limits.excess(target(49.0, 10.0, 500.0), HOME, flies=True) == ""
    assert "53 m from home" in limits.excess(target(53.0, 0.0, 500.0), HOME, flies=True)
    assert "height of 32 m" in limits.excess(target(0.0, 0.0, 520.0), HOME, flies=True)
    assert limits.excess(target(0.0, 0.0, 520.0), HOME, flies=False) == "", "a rover has no heights"
    assert limits.excess(target(0.0, 0.0, float("nan")), HOME, flies=True) == ""
    without_place = dialect.MAVLink_position_target_global_int_message(0, 5, 0, 0, 0, 0.0, *[0.0] * 8)
    assert limits.excess(without_place, HOME, flies=True) == ""

"""The compact text of a plan gives the same plan again, for every file format."""

from __future__ import annotations

import pytest
from plan_texts import HOME, TAKEOFF, WAYPOINT, circle, landing, plan, rows, simple, survey, zone

from lfield.driver import MissionFileError
from lfield_mavlink.files.plan_report import read_plan_file
from lfield_mavlink.files.plan_text import embedded_plan, read_plan_text


def test_compact_text_keeps_every_part_of_a_plan():
    data = plan(
        simple(TAKEOFF),
        survey(simple(WAYPOINT, 20.0), simple(177, p=(1.0, 2.0, 0, 0), frame=2)),
        landing(),
        polygons=[zone((0, 0), (0, 90), (90, 90), inclusion=False)],
        circles=[circle(50.0)],
        rally=[(1, 2, 3.0)],
    )
    text = embedded_plan("plans/north-field.plan", data)
    assert text.startswith("north-field.plan\n")
    before, after = read_plan_file("north-field.plan", data), read_plan_text(text)
    assert after.file == "north-field.plan"
    pairs = zip(before.items, after.items, strict=True)
    assert [each.item.matches(other.item) for each, other in pairs] == [True] * 6
    assert (after.kind, after.firmware, after.home) == (before.kind, before.firmware, HOME)
    assert [len(each.corners) for each in after.fence] == [3, 1]
    assert len(after.rally) == 1
    # The compact text of a compact text is the same text.
    assert embedded_plan("north-field.plan", text.partition("\n")[2].encode()) == text
    assert len(text) < len(data)


def test_compact_text_of_a_file_numbered_from_0():
    up, jump = (3, TAKEOFF, 0, 0, 0, 0, 0.0, 0.0, 10.0), (2, 177, 0, 3, 0, 0, 0.0, 0.0, 0.0)
    data = rows(up, jump, home=None)
    after = read_plan_text(embedded_plan("a.waypoints", data))
    assert [each.number for each in after.items] == [1, 2]
    assert after.items[1].item.parameters[0] == 1.0
    assert after.mission(px4=True) == read_plan_file("a.waypoints", data).mission(px4=True)


_UP = (3, TAKEOFF, 0, 0, 0, 0, 0.0, 0.0, 9.0)


@pytest.mark.parametrize("text", [plan(simple(TAKEOFF)).decode(), rows(_UP).decode()])
def test_text_without_a_file_name_is_named_plan(text):
    assert read_plan_text(text).file == "plan"


@pytest.mark.parametrize("text", ["", "a", "a\n", "\ud800", "a\n{}"])
def test_text_that_is_no_plan_is_refused(text):
    with pytest.raises(MissionFileError):
        read_plan_text(text)

"""A snapshot for the page: made at most at a limited rate, and complete for a page that was suspended."""

from __future__ import annotations

import json

from scripted_team import Script

from lfield.operator.team_model.team_state import Curve, ShownLogLine
from lfield.operator.web.page_snapshots import (
    MAX_LOG_LINES,
    MAX_POINTS,
    MIN_INTERVAL,
    PageSnapshots,
    log_json,
    plots_json,
)


class Time:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def page_snapshots(script: Script, time: Time) -> PageSnapshots:
    return PageSnapshots(script, lambda: script.denied_orders, None, time)


def test_snapshots_are_made_at_most_twenty_times_a_second_for_any_number_of_requests():
    time = Time()
    script = Script(2, now=time)
    views = page_snapshots(script, time)
    for _ in range(1000):
        views.snapshot(0)
        time.now += 0.001
    assert script.revision <= 1 + 1.0 / MIN_INTERVAL


def test_a_resumed_page_needs_one_snapshot():
    time = Time()
    script = Script(2, now=time)
    views = page_snapshots(script, time)
    before = json.loads(views.snapshot(0))
    time.now += 3600.0
    script.say("alpha", "much has happened")
    after = json.loads(views.snapshot(before["log"][-1]["serial"] if before["log"] else 0))
    assert "much has happened" in [line["text"] for line in after["log"]]
    assert after["team"]["vehicles"][0]["position"] != before["team"]["vehicles"][0]["position"]


def test_readings_that_no_page_shows_are_not_sent():
    time = Time()
    vehicle = json.loads(page_snapshots(Script(1, now=time), time).snapshot(0))["team"]["vehicles"][0]
    assert vehicle["devices"][0].keys() == {"name", "fresh", "latched", "confirmed", "moving"}
    assert vehicle["height"] > 0


def test_a_snapshot_of_fifty_vehicles_is_under_61_kilobytes():
    time = Time()
    assert len(page_snapshots(Script(50, now=time), time).snapshot(0)) < 61_000


def test_log_lines_are_sent_once_and_limited_in_number():
    log = [ShownLogLine(serial, "alpha", 0.0, 0.0, "", f"line {serial}") for serial in range(5, 2005)]
    assert [line["serial"] for line in json.loads(log_json(log, 2002))] == [2003, 2004]
    assert json.loads(log_json(log, 2004)) == []
    newest = [line["serial"] for line in json.loads(log_json(log, 0))]
    assert newest == list(range(2005 - MAX_LOG_LINES, 2005))


def test_thinned_curves_keep_the_newest_point():
    curve = Curve("height", "lead", tuple((float(n), float(n)) for n in range(1000, -1, -1)))
    (drawn,) = json.loads(plots_json([curve]))
    assert len(drawn["points"]) <= MAX_POINTS
    assert drawn["points"][-1] == [0.0, 0.0]
    ages = [point[0] for point in drawn["points"]]
    assert ages == sorted(ages, reverse=True)

"""The log of the team's picture, its curves, and events of earlier snapshots."""

from __future__ import annotations

import pytest
from dashboard_script import INCARNATION, ScriptedHost, resource, snapshot
from msgspec.structs import replace
from picture_story import HOP, ZURICH, Story

from lfield.driver.frame import Pose
from lfield.manifest import DeviceManifest, Quantity
from lfield.mission.bindings import Frames
from lfield.operator.team_model.agent_tracker import MAX_AGENTS
from lfield.operator.team_model.device_tracker import MAX_DEVICES
from lfield.operator.team_model.vehicle_readings import instruments_of
from lfield.wire.coordinator_messages import CoordinatorState
from lfield.wire.events import (
    AgentActivity,
    AgentStarted,
    DeviceLatched,
    DeviceTelemetry,
    EmergencyStopChanged,
    Event,
    EventsDropped,
    LineLogged,
    LinkUp,
    MigrationArrived,
    MigrationStarted,
    PauseChanged,
    Printed,
)


def test_the_log_has_whole_lines_for_any_pieces_of_output() -> None:
    story = Story()
    story.tell("alpha", LineLogged("up"), Printed("boss", "hi", "log"))
    story.tell("alpha", Printed("boss", "a b", "out"), Printed("boss", " c\nd\n", "out"))
    lines = [(line.serial, line.host, line.agent, line.text) for line in story.seen.log]
    assert lines == [
        (1, "alpha", "", "up"),
        (2, "alpha", "boss", "hi"),
        (3, "alpha", "boss", "a b c"),
        (4, "alpha", "boss", "d"),
    ]


def test_lost_events_are_counted_by_kind() -> None:
    story = Story()
    story.tell("alpha", EventsDropped("began", 40), lost={"measured": 2})
    story.tell("alpha", lost={"measured": 3})
    assert story.seen.hosts["alpha"].lost_events == {"began": 40, "measured": 5}


def test_a_restarted_host_starts_with_an_empty_state() -> None:
    story = Story()
    story.tell(
        "alpha",
        EmergencyStopChanged("anna", "a child"),
        DeviceLatched("one.fc", "land", "a child"),
        PauseChanged("anna"),
    )
    story.hosts["alpha"], story.aside["alpha"] = ScriptedHost(INCARNATION + 1), -99.0
    story.tell("alpha", snapshot=snapshot("alpha", agents=[resource("one")]))
    alpha = story.seen.hosts["alpha"]
    assert (alpha.restarts, alpha.stopped, alpha.paused, alpha.linked) == (1, "", False, True)
    assert not story.seen.vehicles["one"].latched


def test_curves_have_a_point_per_second_and_drop_old_points() -> None:
    story = Story()
    for _ in range(700):
        story.tell("alpha", DeviceTelemetry("one.fc", {"battery": 0.5, "altitude": 7.0}, 0.0))
        story.picture.tick(story.now)
        story.now += 1.0
    curves = {(curve.quantity, curve.agent): curve.points for curve in story.picture.curves(story.now)}
    assert len(curves["battery", "one"]) in (600, 601)
    assert curves["battery", "one"][-1] == (1.0, 0.5)
    assert curves["height", "one"][-1] == (1.0, 7.0)
    assert curves["hops", "boss"][-1] == (1.0, 0.0)


def test_hops_per_minute_count_the_last_minute() -> None:
    story = Story()
    for sequence in range(30):
        story.tell("alpha", MigrationArrived("boss", 1, sequence, "beta", 900))
        story.now += 10.0
    story.picture.tick(story.now)
    (hops,) = (curve for curve in story.picture.curves(story.now) if curve.quantity == "hops")
    assert hops.points[-1][1] == 6.0


def test_the_revision_grows_with_events_and_not_with_time() -> None:
    story = Story()
    before = story.seen.revision
    story.now += 5.0
    assert story.seen.revision == before
    story.tell("alpha", LinkUp("beta"))
    assert story.seen.revision > before


def test_events_older_than_a_snapshot_change_nothing() -> None:
    story = Story()
    host = story.hosts["alpha"]
    old = host.batch(
        1.0, AgentStarted("boss", 1), HOP["left"][1], DeviceLatched("one.fc", "land", "x"), LineLogged("hi")
    )
    up = story.now - 50.0
    story.picture.feed("alpha", host.batch(up, snapshot=snapshot("alpha")), story.now, 1.7e9)
    story.picture.feed("alpha", old, story.now, 1.7e9)
    boss = story.seen.agents["boss"]
    assert (boss.target, [hop.target for hop in boss.trail]) == ("", ["beta"])
    assert not story.seen.vehicles["one"].latched
    assert [line.text for line in story.seen.log] == ["hi"]


def test_a_log_line_has_the_timestamp_of_its_event() -> None:
    story = Story()
    host = story.hosts["beta"]
    batch = host.batch(5.0, LineLogged("hi"))
    # The clock of beta is 90.25 s behind the clocks of hosts from which it has received messages.
    event = replace(batch.events[0], ahead=90_250, tick=3)
    story.picture.feed("beta", replace(batch, events=[event]), story.now, 1.7e9)
    (line,) = story.seen.log
    assert (line.at - host.wall, line.tick) == (pytest.approx(95.25), 3)


def test_log_times_of_a_host_do_not_go_back_after_a_restart_with_an_earlier_clock() -> None:
    story = Story()
    story.tell("alpha", LineLogged("one"))
    host = ScriptedHost(99, wall=5.0)
    story.picture.feed("alpha", host.batch(1.0, LineLogged("two")), story.now + 0.1, 1.7e9)
    first, second = story.seen.log
    assert (first.text, second.text) == ("one", "two")
    assert first.at <= second.at


def test_an_ended_coordinator_has_the_hop_count_of_its_last_host() -> None:
    story = Story()
    ended = CoordinatorState("boss", 1, 9, 9, "EXITED", "beta", "done")
    other = snapshot("alpha")
    other.coordinators.append(CoordinatorState("boss", 1, 4, 4, "EXITED", "beta", "done"))
    story.tell("alpha", snapshot=other)
    assert story.seen.agents["boss"].hops is None
    own = snapshot("beta")
    own.coordinators.append(ended)
    story.tell("beta", snapshot=own)
    story.tell("alpha", snapshot=other)
    boss = story.seen.agents["boss"]
    assert (boss.finished, boss.hops) == ("done", 9)


def test_the_log_starts_with_earlier_lines_and_repeats_none() -> None:
    story = Story()
    host = story.hosts["alpha"]
    before = [
        host.event(up, what) for up, what in ((1.0, Printed("boss", "on", "out")), (2.0, LineLogged("up")))
    ]
    story.picture.hold_log()
    story.tell("alpha", Printed("boss", "e\n", "out"), LineLogged("now"))
    assert story.seen.log == ()
    # The reader of the past may read events that also arrive here.
    again = [Event(3, 0.0, 3.0, 0, Printed("boss", "e\n", "out")), Event(4, 0.0, 3.0, 0, LineLogged("now"))]
    past = [("alpha", INCARNATION, event) for event in (*before, *again)]
    story.picture.start_log(past, story.now, 1.7e9 + story.now)
    assert [line.text for line in story.seen.log] == ["up", "one", "now"]
    assert [line.serial for line in story.seen.log] == [1, 2, 3]
    assert story.seen.log[0].age == pytest.approx(story.now + story.aside["alpha"] - 2.0)
    story.tell("alpha", LineLogged("later"))
    assert story.seen.log[-1].text == "later"


def test_earlier_lines_of_a_host_without_contact_are_kept() -> None:
    story = Story()
    story.picture.hold_log()
    event = story.hosts["alpha"].event(1.0, LineLogged("up"))
    story.picture.start_log([("alpha", INCARNATION, event)], story.now, event.at + 60.0)
    assert [(line.text, line.age) for line in story.seen.log] == [("up", pytest.approx(60.0))]
    assert not story.seen.hosts["alpha"].linked


def test_dropped_lines_are_shown_in_place_and_counted_from_any_start() -> None:
    story = Story()
    host = story.hosts["alpha"]
    story.picture.hold_log()
    past = [
        host.event(1.0, what)
        for what in (LineLogged("a"), EventsDropped("printed", 40), EventsDropped("left", 2))
    ]
    story.tell("alpha", EventsDropped("printed", 2), LineLogged("b"))
    story.picture.start_log([("alpha", INCARNATION, event) for event in past], story.now, 1.7e9)
    forty, two = (f"{count} lines left out: too frequent" for count in (40, 2))
    assert [line.text for line in story.seen.log] == ["a", forty, two, "b"]
    assert story.seen.hosts["alpha"].lost_events == {"printed": 42, "left": 2}


def test_dropped_events_older_than_a_snapshot_still_count() -> None:
    story = Story()
    host = story.hosts["alpha"]
    old = host.batch(1.0, EventsDropped("left", 5))
    story.picture.feed("alpha", host.batch(2.0, snapshot=snapshot("alpha")), story.now, 1.7e9)
    story.picture.feed("alpha", old, story.now, 1.7e9)
    assert story.seen.hosts["alpha"].lost_events == {"left": 5}


def test_a_coordinator_with_dropped_hops_is_at_the_host_that_reports_it() -> None:
    story = Story()
    story.tell("alpha", AgentStarted("boss", 1))
    story.now += 10.0
    story.tell("beta", AgentActivity("boss", "ready", "mission.L", 7, ""))
    boss = story.seen.agents["boss"]
    assert (boss.host, boss.line, boss.target) == ("beta", 7, "")


def test_an_unchanged_position_of_a_returning_coordinator_is_kept() -> None:
    story = Story()
    story.tell(
        "alpha", AgentStarted("boss", 1), AgentActivity("boss", "waiting", "mission.L", 12, "two.lift")
    )
    for part in HOP.values():
        story.tell(*part)
    assert story.seen.agents["boss"].line == 0
    story.tell("beta", MigrationStarted("boss", 1, 5, "alpha", "one", "lift", 900))
    story.tell("alpha", MigrationArrived("boss", 1, 5, "beta", 900))
    assert story.seen.agents["boss"].line == 12


def test_a_host_that_names_too_many_agents_does_not_fill_the_memory() -> None:
    story = Story()
    for number in range(MAX_AGENTS + 50):
        story.tell("alpha", AgentStarted(f"a{number}", 1), DeviceTelemetry(f"a{number}.fc", {}, 0.0))
    assert len(story.seen.agents) == MAX_AGENTS
    # The device of another host keeps its place.
    assert len(story.seen.vehicles) == MAX_DEVICES + 1
    assert "two" in story.seen.vehicles


@pytest.mark.parametrize(
    ("name", "unit", "is_earth"),
    [
        ("temperatures", "°C", False),
        ("angles", "°", False),
        ("position", "°, °, m", True),
        ("fix", "°, °", True),
        ("globalPosition", "", True),
    ],
)
def test_only_degrees_of_latitude_and_longitude_are_a_position(name: str, unit: str, is_earth: bool) -> None:
    told = (Quantity(name, "real[]", unit=unit),)
    assert instruments_of(DeviceManifest("Motors", "x", (), told)).geo_position == (name if is_earth else "")


def test_a_servo_is_at_its_frame_and_unplaced_without_one() -> None:
    pose = Pose(2.0, 0.5)
    story = Story(Frames(ZURICH, agents={"one": pose}))
    warm = {"temperatures": [28.0, 28.0], "positions": [0.1, 0.2]}
    story.tell("alpha", DeviceTelemetry("one.fc", warm, 0.0), DeviceTelemetry("two.fc", warm, 0.0))
    one, two = (story.seen.vehicles[name] for name in ("one", "two"))
    assert (one.position, one.is_position_stated, one.geo_position.latitude) == (
        (2.0, 0.5, 0.0),
        True,
        pytest.approx(47.3977, abs=1e-4),
    )
    assert (two.position, two.geo_position) == (None, None)

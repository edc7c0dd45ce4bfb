"""The log of the team's picture, its curves, and events of earlier snapshots."""

from __future__ import annotations

import pytest
from dashboard_script import INCARNATION, ScriptedHost, resource, snapshot
from msgspec.structs import replace
from picture_scenario import HOP, ZURICH, Scenario

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
    scenario = Scenario()
    scenario.tell("alpha", LineLogged("up"), Printed("boss", "hi", "log"))
    scenario.tell("alpha", Printed("boss", "a b", "out"), Printed("boss", " c\nd\n", "out"))
    lines = [(line.serial, line.host, line.agent, line.text) for line in scenario.seen.log]
    assert lines == [
        (1, "alpha", "", "up"),
        (2, "alpha", "boss", "hi"),
        (3, "alpha", "boss", "a b c"),
        (4, "alpha", "boss", "d"),
    ]


def test_lost_events_are_counted_by_kind() -> None:
    scenario = Scenario()
    scenario.tell("alpha", EventsDropped("began", 40), lost={"measured": 2})
    scenario.tell("alpha", lost={"measured": 3})
    assert scenario.seen.hosts["alpha"].lost_events == {"began": 40, "measured": 5}


def test_a_restarted_host_starts_with_an_empty_state() -> None:
    scenario = Scenario()
    scenario.tell(
        "alpha",
        EmergencyStopChanged("anna", "a child"),
        DeviceLatched("one.fc", "land", "a child"),
        PauseChanged("anna"),
    )
    scenario.hosts["alpha"], scenario.aside["alpha"] = ScriptedHost(INCARNATION + 1), -99.0
    scenario.tell("alpha", snapshot=snapshot("alpha", agents=[resource("one")]))
    alpha = scenario.seen.hosts["alpha"]
    assert (alpha.restarts, alpha.stopped, alpha.paused, alpha.linked) == (1, "", False, True)
    assert not scenario.seen.vehicles["one"].latched


def test_curves_have_a_point_per_second_and_drop_old_points() -> None:
    scenario = Scenario()
    for _ in range(700):
        scenario.tell("alpha", DeviceTelemetry("one.fc", {"battery": 0.5, "altitude": 7.0}, 0.0))
        scenario.picture.tick(scenario.now)
        scenario.now += 1.0
    curves = {(curve.quantity, curve.agent): curve.points for curve in scenario.picture.curves(scenario.now)}
    assert len(curves["battery", "one"]) in (600, 601)
    assert curves["battery", "one"][-1] == (1.0, 0.5)
    assert curves["height", "one"][-1] == (1.0, 7.0)
    assert curves["hops", "boss"][-1] == (1.0, 0.0)


def test_hops_per_minute_count_the_last_minute() -> None:
    scenario = Scenario()
    for sequence in range(30):
        scenario.tell("alpha", MigrationArrived("boss", 1, sequence, "beta", 900))
        scenario.now += 10.0
    scenario.picture.tick(scenario.now)
    (hops,) = (curve for curve in scenario.picture.curves(scenario.now) if curve.quantity == "hops")
    assert hops.points[-1][1] == 6.0


def test_the_revision_grows_with_events_and_not_with_time() -> None:
    scenario = Scenario()
    before = scenario.seen.revision
    scenario.now += 5.0
    assert scenario.seen.revision == before
    scenario.tell("alpha", LinkUp("beta"))
    assert scenario.seen.revision > before


def test_events_older_than_a_snapshot_change_nothing() -> None:
    scenario = Scenario()
    host = scenario.hosts["alpha"]
    old = host.batch(
        1.0, AgentStarted("boss", 1), HOP["left"][1], DeviceLatched("one.fc", "land", "x"), LineLogged("hi")
    )
    up = scenario.now - 50.0
    scenario.picture.feed("alpha", host.batch(up, snapshot=snapshot("alpha")), scenario.now, 1.7e9)
    scenario.picture.feed("alpha", old, scenario.now, 1.7e9)
    boss = scenario.seen.agents["boss"]
    assert (boss.target, [hop.target for hop in boss.trail]) == ("", ["beta"])
    assert not scenario.seen.vehicles["one"].latched
    assert [line.text for line in scenario.seen.log] == ["hi"]


def test_a_log_line_has_the_timestamp_of_its_event() -> None:
    scenario = Scenario()
    host = scenario.hosts["beta"]
    batch = host.batch(5.0, LineLogged("hi"))
    # The clock of beta is 90.25 s behind the clocks of hosts from which it has received messages.
    event = replace(batch.events[0], ahead=90_250, tick=3)
    scenario.picture.feed("beta", replace(batch, events=[event]), scenario.now, 1.7e9)
    (line,) = scenario.seen.log
    assert (line.at - host.wall, line.tick) == (pytest.approx(95.25), 3)


def test_log_times_of_a_host_do_not_go_back_after_a_restart_with_an_earlier_clock() -> None:
    scenario = Scenario()
    scenario.tell("alpha", LineLogged("one"))
    host = ScriptedHost(99, wall=5.0)
    scenario.picture.feed("alpha", host.batch(1.0, LineLogged("two")), scenario.now + 0.1, 1.7e9)
    first, second = scenario.seen.log
    assert (first.text, second.text) == ("one", "two")
    assert first.at <= second.at


def test_an_ended_coordinator_has_the_hop_count_of_its_last_host() -> None:
    scenario = Scenario()
    ended = CoordinatorState("boss", 1, 9, 9, "EXITED", "beta", "done")
    other = snapshot("alpha")
    other.coordinators.append(CoordinatorState("boss", 1, 4, 4, "EXITED", "beta", "done"))
    scenario.tell("alpha", snapshot=other)
    assert scenario.seen.agents["boss"].hops is None
    own = snapshot("beta")
    own.coordinators.append(ended)
    scenario.tell("beta", snapshot=own)
    scenario.tell("alpha", snapshot=other)
    boss = scenario.seen.agents["boss"]
    assert (boss.finished, boss.hops) == ("done", 9)


def test_the_log_starts_with_earlier_lines_and_repeats_none() -> None:
    scenario = Scenario()
    host = scenario.hosts["alpha"]
    before = [
        host.event(up, what) for up, what in ((1.0, Printed("boss", "on", "out")), (2.0, LineLogged("up")))
    ]
    scenario.picture.hold_log()
    scenario.tell("alpha", Printed("boss", "e\n", "out"), LineLogged("now"))
    assert scenario.seen.log == ()
    # The reader of the past may read events that also arrive here.
    again = [Event(3, 0.0, 3.0, 0, Printed("boss", "e\n", "out")), Event(4, 0.0, 3.0, 0, LineLogged("now"))]
    past = [("alpha", INCARNATION, event) for event in (*before, *again)]
    scenario.picture.start_log(past, scenario.now, 1.7e9 + scenario.now)
    assert [line.text for line in scenario.seen.log] == ["up", "one", "now"]
    assert [line.serial for line in scenario.seen.log] == [1, 2, 3]
    assert scenario.seen.log[0].age == pytest.approx(scenario.now + scenario.aside["alpha"] - 2.0)
    scenario.tell("alpha", LineLogged("later"))
    assert scenario.seen.log[-1].text == "later"


def test_earlier_lines_of_a_host_without_contact_are_kept() -> None:
    scenario = Scenario()
    scenario.picture.hold_log()
    event = scenario.hosts["alpha"].event(1.0, LineLogged("up"))
    scenario.picture.start_log([("alpha", INCARNATION, event)], scenario.now, event.at + 60.0)
    assert [(line.text, line.age) for line in scenario.seen.log] == [("up", pytest.approx(60.0))]
    assert not scenario.seen.hosts["alpha"].linked


def test_dropped_lines_are_shown_in_place_and_counted_from_any_start() -> None:
    scenario = Scenario()
    host = scenario.hosts["alpha"]
    scenario.picture.hold_log()
    past = [
        host.event(1.0, what)
        for what in (LineLogged("a"), EventsDropped("printed", 40), EventsDropped("left", 2))
    ]
    scenario.tell("alpha", EventsDropped("printed", 2), LineLogged("b"))
    scenario.picture.start_log([("alpha", INCARNATION, event) for event in past], scenario.now, 1.7e9)
    forty, two = (f"{count} lines left out: too frequent" for count in (40, 2))
    assert [line.text for line in scenario.seen.log] == ["a", forty, two, "b"]
    assert scenario.seen.hosts["alpha"].lost_events == {"printed": 42, "left": 2}


def test_dropped_events_older_than_a_snapshot_still_count() -> None:
    scenario = Scenario()
    host = scenario.hosts["alpha"]
    old = host.batch(1.0, EventsDropped("left", 5))
    scenario.picture.feed("alpha", host.batch(2.0, snapshot=snapshot("alpha")), scenario.now, 1.7e9)
    scenario.picture.feed("alpha", old, scenario.now, 1.7e9)
    assert scenario.seen.hosts["alpha"].lost_events == {"left": 5}


def test_a_coordinator_with_dropped_hops_is_at_the_host_that_reports_it() -> None:
    scenario = Scenario()
    scenario.tell("alpha", AgentStarted("boss", 1))
    scenario.now += 10.0
    scenario.tell("beta", AgentActivity("boss", "ready", "mission.L", 7, ""))
    boss = scenario.seen.agents["boss"]
    assert (boss.host, boss.line, boss.target) == ("beta", 7, "")


def test_an_unchanged_position_of_a_returning_coordinator_is_kept() -> None:
    scenario = Scenario()
    scenario.tell(
        "alpha", AgentStarted("boss", 1), AgentActivity("boss", "waiting", "mission.L", 12, "two.lift")
    )
    for part in HOP.values():
        scenario.tell(*part)
    assert scenario.seen.agents["boss"].line == 0
    scenario.tell("beta", MigrationStarted("boss", 1, 5, "alpha", "one", "lift", 900))
    scenario.tell("alpha", MigrationArrived("boss", 1, 5, "beta", 900))
    assert scenario.seen.agents["boss"].line == 12


def test_a_host_that_names_too_many_agents_does_not_fill_the_memory() -> None:
    scenario = Scenario()
    for number in range(MAX_AGENTS + 50):
        scenario.tell("alpha", AgentStarted(f"a{number}", 1), DeviceTelemetry(f"a{number}.fc", {}, 0.0))
    assert len(scenario.seen.agents) == MAX_AGENTS
    # The device of another host keeps its place.
    assert len(scenario.seen.vehicles) == MAX_DEVICES + 1
    assert "two" in scenario.seen.vehicles


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
    quantities = (Quantity(name, "real[]", unit=unit),)
    assert instruments_of(DeviceManifest("Motors", "x", (), quantities)).geo_position == (
        name if is_earth else ""
    )


def test_a_servo_is_at_its_frame_and_unplaced_without_one() -> None:
    pose = Pose(2.0, 0.5)
    scenario = Scenario(Frames(ZURICH, agents={"one": pose}))
    warm = {"temperatures": [28.0, 28.0], "positions": [0.1, 0.2]}
    scenario.tell("alpha", DeviceTelemetry("one.fc", warm, 0.0), DeviceTelemetry("two.fc", warm, 0.0))
    one, two = (scenario.seen.vehicles[name] for name in ("one", "two"))
    assert (one.position, one.is_position_stated, one.geo_position.latitude) == (
        (2.0, 0.5, 0.0),
        True,
        pytest.approx(47.3977, abs=1e-4),
    )
    assert (two.position, two.geo_position) == (None, None)

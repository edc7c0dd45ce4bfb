"""The state of a team from its hosts' events: `TeamView` alone, with the times of the test."""

from __future__ import annotations

import math
from itertools import permutations

import pytest
from dashboard_script import INCARNATION, ScriptedHost, device, inventory, resource, snapshot
from msgspec.structs import replace

from lfield.driver.frame import Origin, Pose
from lfield.guard.standstill import UNCONFIRMED
from lfield.manifest import DeviceManifest, Quantity
from lfield.mission.bindings import Frames
from lfield.operator.team_model.agent_tracker import MAX_AGENTS
from lfield.operator.team_model.device_tracker import MAX_DEVICES
from lfield.operator.team_model.team_state import LinkState, StopState
from lfield.operator.team_model.team_view import TeamView
from lfield.operator.team_model.vehicle_readings import instruments_of
from lfield.wire.coordinator_messages import CoordinatorState
from lfield.wire.events import (
    AgentActivity,
    AgentFinished,
    AgentStarted,
    CoordinatorSuperseded,
    DeviceLatched,
    DeviceMoving,
    DeviceReleased,
    DeviceTelemetry,
    EmergencyStopChanged,
    Event,
    EventsDropped,
    HostStopping,
    LineLogged,
    LinkDown,
    LinkTelemetry,
    LinkUp,
    MigrationArrived,
    MigrationConfirmed,
    MigrationFailed,
    MigrationStarted,
    OfferPublished,
    OfferWithdrawn,
    PauseChanged,
    Printed,
    SafeStateConfirmed,
)
from lfield.wire.observer_messages import BundleStatus, EmergencyStopResult, StartStatus, UnlinkableHost


class Story:
    """A picture, and both hosts that send it events; their monotonic clocks differ from ours."""

    def __init__(self, frames: Frames | None = None) -> None:
        self.picture = TeamView(inventory(frames))
        self.hosts = {"alpha": ScriptedHost(), "beta": ScriptedHost(8)}
        self.aside = {"alpha": -50.0, "beta": 4000.0}
        self.now = 100.0

    def tell(self, host: str, *whats: object, **more: object) -> None:
        batch = self.hosts[host].batch(self.now + self.aside[host], *whats, **more)  # type: ignore[arg-type]
        self.picture.feed(host, batch, self.now, 1.7e9)

    @property
    def seen(self):  # type: ignore[no-untyped-def]
        return self.picture.snapshot(self.now)


def test_a_host_without_contact_is_shown_as_such() -> None:
    story = Story()
    alpha = story.seen.hosts["alpha"]
    assert (alpha.age, alpha.linked, alpha.trouble) == (None, False, "no contact yet")
    assert story.seen.vehicles["one"].place is None
    assert not story.seen.vehicles["one"].fresh


def test_a_snapshot_sets_the_picture() -> None:
    story = Story()
    one = device("one.fc", position=[1.0, 2.0, -3.0], heading=1.5, battery=0.5, mode="GUIDED", armed=True)
    story.tell("alpha", snapshot=snapshot("alpha", one, agents=[resource("one")]))
    vehicle = story.seen.vehicles["one"]
    assert vehicle.place == (1.0, 2.0, -3.0)
    assert vehicle.height == 3.0
    assert (vehicle.heading, vehicle.battery, vehicle.mode, vehicle.armed) == (1.5, 0.5, "GUIDED", True)
    assert vehicle.fresh
    assert vehicle.link == 0.0
    assert story.seen.agents["one"].served == 3
    assert story.seen.hosts["alpha"].links == {"beta": LinkState()}
    assert {name: offer.refusal for name, offer in story.seen.offers.items()} == {"one": "", "two": ""}


def test_the_last_state_of_a_dead_host_ages() -> None:
    story = Story()
    story.tell("alpha", snapshot=snapshot("alpha", device("one.fc", battery=0.5)))
    story.tell("alpha", HostStopping("it was told to end"))
    story.picture.on_unlinked("alpha", "nobody listens at alpha:8181")
    story.now += 60.0
    alpha, vehicle = story.seen.hosts["alpha"], story.seen.vehicles["one"]
    assert (alpha.linked, alpha.age, alpha.ending) == (False, 60.0, "it was told to end")
    assert alpha.trouble == "nobody listens at alpha:8181"
    assert (vehicle.fresh, vehicle.battery, vehicle.link) == (False, 0.5, 60.0)


def test_telemetry_has_the_age_it_reports() -> None:
    story = Story()
    story.tell("alpha", DeviceTelemetry("one.fc", {"battery": 0.4}, 2.0))
    story.now += 1.0
    reading = story.seen.vehicles["one"].devices[0].readings["battery"]
    assert (reading.value, reading.age) == (0.4, 3.0)


def test_a_delayed_batch_is_shown_with_its_age() -> None:
    story = Story()
    story.tell("alpha", LinkUp("beta"))
    late = story.hosts["alpha"].batch(
        story.now + 1.0 - 50.0, DeviceTelemetry("one.fc", {"battery": 0.4}, 0.0)
    )
    story.now += 11.0
    story.picture.feed("alpha", late, story.now, 1.7e9)
    assert story.seen.vehicles["one"].link == pytest.approx(10.0, abs=0.1)


HOP = {
    "left": ("alpha", MigrationStarted("boss", 1, 4, "beta", "two", "lift", 900)),
    "came": ("beta", MigrationArrived("boss", 1, 4, "alpha", 900)),
    "hopped": ("alpha", MigrationConfirmed("boss", 1, 4, "beta", 0.02)),
}


@pytest.mark.parametrize("order", list(permutations(HOP)))
def test_a_hop_ends_at_its_target_in_any_order_of_reports(order: tuple[str, ...]) -> None:
    # The events of one host keep their order.
    if order.index("left") > order.index("hopped"):
        return
    story = Story()
    story.tell("alpha", AgentStarted("boss", 1))
    for part in order:
        story.tell(*HOP[part])
    boss = story.seen.coordinators["boss"]
    assert (boss.host, boss.to, boss.hops, boss.finished) == ("beta", "", 1, "")
    (hop,) = boss.trail
    assert (hop.number, hop.of, hop.to, hop.seconds) == (4, "alpha", "beta", 0.02)
    assert (hop.resource, hop.portal, hop.size) == ("two", "lift", 900)


def test_a_coordinator_is_in_transit_until_it_arrives() -> None:
    story = Story()
    story.tell("alpha", AgentStarted("boss", 1), HOP["left"][1])
    boss = story.seen.agents["boss"]
    assert (boss.host, boss.to, boss.state) == ("alpha", "beta", "on its way")


def test_a_failed_hop_has_its_reason_and_keeps_the_coordinator_in_place() -> None:
    story = Story()
    stayed = MigrationFailed("boss", 1, 4, "beta", "UnreachableResourceException", "no link")
    story.tell("alpha", HOP["left"][1], stayed)
    boss = story.seen.agents["boss"]
    assert (boss.host, boss.to) == ("alpha", "")
    assert boss.trail[0].failed == "UnreachableResourceException: no link"


def test_late_reports_of_a_hop_do_not_move_a_coordinator() -> None:
    story = Story()
    story.tell(
        "beta",
        MigrationArrived("boss", 1, 4, "alpha", 900),
        MigrationStarted("boss", 1, 5, "alpha", "one", "lift", 900),
    )
    story.tell("alpha", MigrationArrived("boss", 1, 5, "beta", 900))
    story.tell("alpha", HOP["left"][1], HOP["hopped"][1])
    boss = story.seen.agents["boss"]
    assert (boss.host, boss.hops) == ("alpha", 2)
    assert [hop.number for hop in boss.trail] == [4, 5]


def test_the_position_of_a_coordinator_is_that_of_the_host_that_has_it() -> None:
    story = Story()
    story.tell(
        "alpha", AgentStarted("boss", 1), AgentActivity("boss", "waiting", "mission.L", 12, "two.lift")
    )
    story.tell("beta", AgentActivity("boss", "ready", "mission.L", 3, ""))
    boss = story.seen.agents["boss"]
    assert (boss.state, boss.file, boss.line, boss.waits) == ("waiting", "mission.L", 12, "two.lift")


def test_a_superseded_start_leaves_the_coordinator_to_the_earlier_one() -> None:
    story = Story()
    story.tell("alpha", AgentStarted("boss", 2))
    story.tell("beta", AgentStarted("boss", 1))
    assert story.seen.agents["boss"].host == "alpha"
    story.tell(
        "alpha",
        CoordinatorSuperseded("boss", 2, "start 1 is alive"),
        AgentFinished("boss", 2, "superseded", ""),
    )
    assert story.seen.agents["boss"].finished == "superseded"
    story.tell("beta", MigrationArrived("boss", 1, 3, "alpha", 900))
    boss = story.seen.agents["boss"]
    assert (boss.host, boss.generation, boss.finished) == ("beta", 1, "")


def test_a_snapshot_sets_the_hosts_of_coordinators() -> None:
    story = Story()
    copies = [CoordinatorState("boss", 2, 9, 5, "IN DOUBT", "beta", "", "beta is gone")]
    status = snapshot("alpha")
    story.tell("alpha", snapshot=type(status)(**{**_fields(status), "coordinators": copies}))
    assert story.seen.agents["boss"].doubt == "beta is gone"
    copies = [CoordinatorState("boss", 2, 9, 5, "RUN")]
    status = snapshot("beta")
    story.tell("beta", snapshot=type(status)(**{**_fields(status), "coordinators": copies}))
    boss = story.seen.agents["boss"]
    assert (boss.host, boss.doubt, boss.hops, boss.generation) == ("beta", "", 5, 2)


def test_a_snapshot_has_the_bundle_the_delayed_start_and_refused_hosts() -> None:
    story = Story()
    status = snapshot("alpha")
    more = {
        "bundle": BundleStatus(bytes.fromhex("5cde09b1f2a37c4400"), "anna", 0.0),
        "start": StartStatus(["boss"], ["beta"], [], ""),
        "refused": [UnlinkableHost("beta", "another bundle", b"\x77")],
    }
    story.tell("alpha", snapshot=type(status)(**{**_fields(status), **more}))
    host = story.seen.hosts["alpha"]
    assert host.bundle == "5cde09b1f2a37c44"
    assert host.waits_for == ("beta",)
    assert host.refused == {"beta": "another bundle"}


def _fields(status: object) -> dict[str, object]:
    return {name: getattr(status, name) for name in status.__struct_fields__}  # type: ignore[attr-defined]


def test_a_latch_is_shown_confirmed_at_rest_and_released() -> None:
    story = Story()
    story.tell("alpha", DeviceLatched("one.fc", "land", "the link is lost"))
    (fc,) = story.seen.vehicles["one"].devices
    assert (fc.latched, fc.confirmed, fc.at_rest) == ("the link is lost", False, False)
    story.tell(
        "alpha", SafeStateConfirmed("one.fc", "land", "the link is lost"), DeviceMoving("one.fc", "3 m high")
    )
    (fc,) = story.seen.vehicles["one"].devices
    assert (fc.confirmed, fc.moving, fc.at_rest) == (True, "3 m high", False)
    story.tell("alpha", DeviceMoving("one.fc", ""))
    assert story.seen.vehicles["one"].devices[0].at_rest
    story.tell("alpha", DeviceReleased("one.fc"))
    assert not story.seen.vehicles["one"].latched


def test_a_snapshot_before_the_safe_state_confirms_nothing() -> None:
    story = Story()
    story.tell("alpha", snapshot=snapshot("alpha", device("one.fc", "the link is lost", UNCONFIRMED)))
    (fc,) = story.seen.vehicles["one"].devices
    assert (fc.latched, fc.confirmed, fc.moving) == ("the link is lost", False, "")


def test_a_stop_shows_confirmed_and_unconfirmed_devices() -> None:
    story = Story()
    story.tell("alpha", EmergencyStopChanged("anna", "a child"), DeviceLatched("one.fc", "land", "a child"))
    story.tell("beta", LinkUp("alpha"))
    stop = story.seen.stop
    assert (stop.stands, stop.complete, stop.by, stop.reason) == (True, False, "anna", "a child")
    assert stop.unconfirmed == {"one.fc": "its safe state is not confirmed yet"}
    assert stop.unreached == {"beta": "the host has not confirmed the stop"}
    story.tell("alpha", SafeStateConfirmed("one.fc", "land", "a child"))
    story.tell("beta", EmergencyStopChanged("anna", "a child"))
    story.picture.on_answer(0, "beta", EmergencyStopResult({"two.fc": "its port is gone"}))
    stop = story.seen.stop
    assert (stop.confirmed, stop.unconfirmed) == (("one.fc",), {"two.fc": "its port is gone"})
    story.tell(
        "beta", DeviceLatched("two.fc", "land", "a child"), SafeStateConfirmed("two.fc", "land", "a child")
    )
    assert story.seen.stop.complete
    story.picture.on_unlinked("beta", "the connection was lost")
    stop = story.seen.stop
    assert (stop.unreached, stop.before, stop.complete) == ({}, {"beta": ("two.fc",)}, False)
    story.tell("alpha", EmergencyStopChanged("anna", "", True))
    stop = story.seen.stop
    assert (stop.stands, stop.unreached, stop.before) == (False, {}, {"beta": ("two.fc",)})
    story.tell("beta", EmergencyStopChanged("anna", "", True))
    assert story.seen.stop == StopState()


def test_pauses_and_offers_appear_and_disappear() -> None:
    story = Story()
    story.tell("alpha", PauseChanged("anna"), OfferPublished("two"), OfferWithdrawn("one", "it has died"))
    story.tell("beta", OfferWithdrawn("two", "unreachable"))
    assert story.seen.paused == ("alpha",)
    assert story.seen.offers["one"].refusal == "it has died"
    two = story.seen.offers["two"]
    assert (two.reported_by, two.refusal, two.apart) == ("beta", "unreachable", {"alpha": ""})
    story.tell("alpha", PauseChanged("anna", True))
    assert story.seen.paused == ()


def test_a_missing_link_ages() -> None:
    story = Story()
    story.tell("alpha", LinkUp("beta"))
    story.tell("alpha", LinkDown("beta"))
    story.now += 3.0
    alpha = story.seen.hosts["alpha"]
    assert (alpha.links, alpha.away) == ({}, {"beta": pytest.approx(3.0, abs=0.01)})


def test_link_figures_are_shown_while_the_link_exists() -> None:
    story = Story()
    story.tell("alpha", LinkUp("beta"), LinkTelemetry("beta", 0.2, 0.05, 1000, 2000))
    assert story.seen.hosts["alpha"].links == {"beta": LinkState(0.2, 0.05, 1000, 2000)}
    story.tell("alpha", LinkDown("beta"))
    story.tell("alpha", LinkTelemetry("beta", 0.3, 0.05, 1000, 2000))
    assert story.seen.hosts["alpha"].links == {}
    story.tell("alpha", LinkUp("beta"))
    assert story.seen.hosts["alpha"].links == {"beta": LinkState()}


def test_the_log_has_whole_lines_for_any_pieces_of_output() -> None:
    story = Story()
    story.tell("alpha", LineLogged("up"), Printed("boss", "hi", "log"))
    story.tell("alpha", Printed("boss", "a b", "out"), Printed("boss", " c\nd\n", "out"))
    told = [(line.serial, line.host, line.agent, line.text) for line in story.seen.log]
    assert told == [
        (1, "alpha", "", "up"),
        (2, "alpha", "boss", "hi"),
        (3, "alpha", "boss", "a b c"),
        (4, "alpha", "boss", "d"),
    ]


def test_lost_events_are_counted_by_kind() -> None:
    story = Story()
    story.tell("alpha", EventsDropped("began", 40), lost={"measured": 2})
    story.tell("alpha", lost={"measured": 3})
    assert story.seen.hosts["alpha"].lost == {"began": 40, "measured": 5}


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


@pytest.mark.parametrize("by_snapshot", [False, True])
def test_another_run_of_the_mission_starts_with_an_empty_state(by_snapshot: bool) -> None:
    story = Story()
    story.tell("alpha", AgentStarted("boss", 2))
    for sequence in range(1, 41):
        of, to = ("alpha", "beta") if sequence % 2 else ("beta", "alpha")
        story.tell(of, MigrationStarted("boss", 2, sequence, to, "two", "lift", 900))
        story.tell(to, MigrationArrived("boss", 2, sequence, of, 900))
    story.tell("alpha", AgentFinished("boss", 2, "done", ""))
    for host in story.hosts:
        story.picture.on_unlinked(host, "the host closed the link")
    story.hosts = {"alpha": ScriptedHost(INCARNATION + 10), "beta": ScriptedHost(INCARNATION + 11)}
    story.now += 20.0
    if by_snapshot:
        status = snapshot("alpha")
        copies = [CoordinatorState("boss", 1, 0, 0, "RUN")]
        story.tell("alpha", snapshot=type(status)(**{**_fields(status), "coordinators": copies}))
    else:
        story.tell("alpha", AgentStarted("boss", 1))
    boss = story.seen.agents["boss"]
    assert (boss.host, boss.generation, boss.hops, boss.finished, boss.trail) == ("alpha", 1, 0, "", ())
    story.tell("alpha", MigrationStarted("boss", 1, 1, "beta", "two", "lift", 900))
    story.tell("beta", MigrationArrived("boss", 1, 1, "alpha", 900))
    story.tell("alpha", MigrationConfirmed("boss", 1, 1, "beta", 0.02))
    boss = story.seen.agents["boss"]
    assert (boss.host, boss.hops, [hop.number for hop in boss.trail]) == ("beta", 1, [1])


def test_a_restart_of_one_host_does_not_change_the_state_of_others() -> None:
    story = Story()
    story.tell("alpha", AgentStarted("boss", 1), HOP["left"][1])
    story.tell(
        "beta", HOP["came"][1], MigrationStarted("boss", 1, 5, "alpha", "one", "lift", 900), LinkUp("alpha")
    )
    story.tell("beta", MigrationFailed("boss", 1, 5, "alpha", "", "no link"))
    story.hosts["alpha"] = ScriptedHost(INCARNATION + 1)
    story.tell("alpha", HOP["left"][1])
    boss = story.seen.agents["boss"]
    assert (boss.host, [hop.number for hop in boss.trail]) == ("beta", [4, 5])


def test_clock_differences_are_shown_and_change_no_age() -> None:
    story = Story()
    story.hosts["alpha"].wall = 1.7e9 + 600.0 - (story.now - 50.0)
    story.tell("alpha", DeviceTelemetry("one.fc", {"battery": 0.4}, 0.0))
    assert story.seen.hosts["alpha"].clock == pytest.approx(600.0)
    assert story.seen.vehicles["one"].link == 0.0


ZURICH = Origin(47.3977, 8.5456, 488.0)


def test_metres_become_degrees_by_the_origin_and_back() -> None:
    story = Story(Frames(ZURICH))
    story.tell("alpha", DeviceTelemetry("one.fc", {"position": [1000.0, -500.0, -20.0]}, 0.0))
    earth = story.seen.vehicles["one"].earth
    assert earth.altitude == 508.0
    # The result of geographiclib; a metre is 1e-5 degrees.
    assert earth.latitude == pytest.approx(47.40669434, abs=1e-6)
    assert earth.longitude == pytest.approx(8.53897546, abs=2e-6)
    story.tell("beta", DeviceTelemetry("two.fc", {"globalPosition": list(earth)}, 0.0))
    north, east, down = story.seen.vehicles["two"].place
    assert (north, east, down) == (pytest.approx(1000.0), pytest.approx(-500.0), -20.0)


def test_vehicles_with_global_positions_only_are_apart_without_an_origin() -> None:
    story = Story()
    here, there = [47.3977, 8.5456, 488.0], [47.3987, 8.5456, 489.0]
    story.tell("alpha", DeviceTelemetry("one.fc", {"globalPosition": here, "position": [0.0, 0.0, 0.0]}, 0.0))
    story.tell("beta", DeviceTelemetry("two.fc", {"globalPosition": there, "position": [0.0, 0.0, 0.0]}, 0.0))
    one, two = (story.seen.vehicles[name].place for name in ("one", "two"))
    assert one == (0.0, 0.0, 0.0)
    assert two.north == pytest.approx(111.2, abs=0.2)
    assert two.down == -1.0


def test_without_a_position_a_vehicle_is_at_its_stated_pose_or_unplaced() -> None:
    story = Story(Frames(agents={"one": Pose(3.0, 4.0)}))
    story.tell("alpha", DeviceTelemetry("one.fc", {"battery": 0.4}, 0.0), DeviceTelemetry("two.fc", {}, 0.0))
    one, two = (story.seen.vehicles[name] for name in ("one", "two"))
    assert (one.place, one.stated, one.measured) == ((3.0, 4.0, 0.0), True, None)
    assert (two.place, two.stated) == (None, False)


@pytest.mark.parametrize("value", [[1.0], [math.nan, 0.0], [1.0] * 5, "here", True, [200.0, 0.0, 0.0]])
def test_invalid_values_of_a_host_are_not_a_position(value: object) -> None:
    story = Story()
    nonsense = {"position": value, "globalPosition": value, "heading": value, "battery": math.inf}
    if value == [200.0, 0.0, 0.0]:
        del nonsense["position"]
    story.tell("alpha", DeviceTelemetry("one.fc", nonsense, 0.0))  # type: ignore[arg-type]
    vehicle = story.seen.vehicles["one"]
    assert (vehicle.place, vehicle.earth, vehicle.heading, vehicle.battery) == (None, None, None, None)


def test_curves_have_a_point_per_second_and_drop_old_points() -> None:
    story = Story()
    for _ in range(700):
        story.tell("alpha", DeviceTelemetry("one.fc", {"battery": 0.5, "altitude": 7.0}, 0.0))
        story.picture.tick(story.now)
        story.now += 1.0
    curves = {(curve.what, curve.of): curve.points for curve in story.picture.curves(story.now)}
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
    (hops,) = (curve for curve in story.picture.curves(story.now) if curve.what == "hops")
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
    assert (boss.to, [hop.to for hop in boss.trail]) == ("", ["beta"])
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
    assert story.seen.hosts["alpha"].lost == {"printed": 42, "left": 2}


def test_dropped_events_older_than_a_snapshot_still_count() -> None:
    story = Story()
    host = story.hosts["alpha"]
    old = host.batch(1.0, EventsDropped("left", 5))
    story.picture.feed("alpha", host.batch(2.0, snapshot=snapshot("alpha")), story.now, 1.7e9)
    story.picture.feed("alpha", old, story.now, 1.7e9)
    assert story.seen.hosts["alpha"].lost == {"left": 5}


def test_a_coordinator_with_dropped_hops_is_at_the_host_that_reports_it() -> None:
    story = Story()
    story.tell("alpha", AgentStarted("boss", 1))
    story.now += 10.0
    story.tell("beta", AgentActivity("boss", "ready", "mission.L", 7, ""))
    boss = story.seen.agents["boss"]
    assert (boss.host, boss.line, boss.to) == ("beta", 7, "")


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
    assert instruments_of(DeviceManifest("Motors", "x", (), told)).earth == (name if is_earth else "")


def test_a_servo_is_at_its_frame_and_unplaced_without_one() -> None:
    pose = Pose(2.0, 0.5)
    story = Story(Frames(ZURICH, agents={"one": pose}))
    warm = {"temperatures": [28.0, 28.0], "positions": [0.1, 0.2]}
    story.tell("alpha", DeviceTelemetry("one.fc", warm, 0.0), DeviceTelemetry("two.fc", warm, 0.0))
    one, two = (story.seen.vehicles[name] for name in ("one", "two"))
    assert (one.place, one.stated, one.earth.latitude) == (
        (2.0, 0.5, 0.0),
        True,
        pytest.approx(47.3977, abs=1e-4),
    )
    assert (two.place, two.earth) == (None, None)

"""What is known of a team, from what its hosts tell: `TeamView` alone, on times that the test gives."""

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
    """A picture, and both hosts that tell it things; their monotonic clocks differ from ours."""

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


def test_a_host_that_was_never_heard_says_so() -> None:
    story = Story()
    alpha = story.seen.hosts["alpha"]
    assert (alpha.age, alpha.linked, alpha.trouble) == (None, False, "no contact yet")
    assert story.seen.vehicles["one"].place is None
    assert not story.seen.vehicles["one"].fresh


def test_a_snapshot_is_the_picture() -> None:
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


def test_what_is_last_known_of_a_dead_host_grows_older() -> None:
    story = Story()
    story.tell("alpha", snapshot=snapshot("alpha", device("one.fc", battery=0.5)))
    story.tell("alpha", HostStopping("it was told to end"))
    story.picture.on_unlinked("alpha", "nobody listens at alpha:8181")
    story.now += 60.0
    alpha, vehicle = story.seen.hosts["alpha"], story.seen.vehicles["one"]
    assert (alpha.linked, alpha.age, alpha.ending) == (False, 60.0, "it was told to end")
    assert alpha.trouble == "nobody listens at alpha:8181"
    assert (vehicle.fresh, vehicle.battery, vehicle.link) == (False, 0.5, 60.0)


def test_telemetry_is_as_old_as_it_says() -> None:
    story = Story()
    story.tell("alpha", DeviceTelemetry("one.fc", {"battery": 0.4}, 2.0))
    story.now += 1.0
    reading = story.seen.vehicles["one"].devices[0].readings["battery"]
    assert (reading.value, reading.age) == (0.4, 3.0)


def test_a_batch_that_was_long_on_its_way_is_old_news() -> None:
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
def test_a_hop_ends_where_it_ended_in_whatever_order_it_is_told(order: tuple[str, ...]) -> None:
    # Within one host the order is that of its stream.
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


def test_a_coordinator_is_on_its_way_until_it_came() -> None:
    story = Story()
    story.tell("alpha", AgentStarted("boss", 1), HOP["left"][1])
    boss = story.seen.agents["boss"]
    assert (boss.host, boss.to, boss.state) == ("alpha", "beta", "on its way")


def test_a_hop_that_failed_says_why_and_the_coordinator_is_where_it_was() -> None:
    story = Story()
    stayed = MigrationFailed("boss", 1, 4, "beta", "UnreachableResourceException", "no link")
    story.tell("alpha", HOP["left"][1], stayed)
    boss = story.seen.agents["boss"]
    assert (boss.host, boss.to) == ("alpha", "")
    assert boss.trail[0].failed == "UnreachableResourceException: no link"


def test_old_news_of_a_hop_moves_nobody() -> None:
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


def test_where_a_coordinator_stands_is_believed_of_the_host_that_has_it() -> None:
    story = Story()
    story.tell(
        "alpha", AgentStarted("boss", 1), AgentActivity("boss", "waiting", "mission.L", 12, "two.lift")
    )
    story.tell("beta", AgentActivity("boss", "ready", "mission.L", 3, ""))
    boss = story.seen.agents["boss"]
    assert (boss.state, boss.file, boss.line, boss.waits) == ("waiting", "mission.L", 12, "two.lift")


def test_a_start_that_gave_way_leaves_the_coordinator_to_the_earlier_one() -> None:
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


def test_a_snapshot_says_where_coordinators_are() -> None:
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


def test_a_host_names_its_bundle_what_its_start_waits_for_and_whom_it_refuses() -> None:
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


def test_a_latch_is_told_confirmed_at_rest_and_released() -> None:
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


def test_a_snapshot_before_the_safe_state_was_seen_confirms_nothing() -> None:
    story = Story()
    story.tell("alpha", snapshot=snapshot("alpha", device("one.fc", "the link is lost", UNCONFIRMED)))
    (fc,) = story.seen.vehicles["one"].devices
    assert (fc.latched, fc.confirmed, fc.moving) == ("the link is lost", False, "")


def test_a_stop_shows_who_has_confirmed_and_who_has_not() -> None:
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


def test_a_pause_and_offers_come_and_go() -> None:
    story = Story()
    story.tell("alpha", PauseChanged("anna"), OfferPublished("two"), OfferWithdrawn("one", "it has died"))
    story.tell("beta", OfferWithdrawn("two", "unreachable"))
    assert story.seen.paused == ("alpha",)
    assert story.seen.offers["one"].refusal == "it has died"
    two = story.seen.offers["two"]
    assert (two.reported_by, two.refusal, two.apart) == ("beta", "unreachable", {"alpha": ""})
    story.tell("alpha", PauseChanged("anna", True))
    assert story.seen.paused == ()


def test_links_that_are_missed_grow_older() -> None:
    story = Story()
    story.tell("alpha", LinkUp("beta"))
    story.tell("alpha", LinkDown("beta"))
    story.now += 3.0
    alpha = story.seen.hosts["alpha"]
    assert (alpha.links, alpha.away) == ({}, {"beta": pytest.approx(3.0, abs=0.01)})


def test_what_is_measured_of_a_link_is_shown_while_there_is_one() -> None:
    story = Story()
    story.tell("alpha", LinkUp("beta"), LinkTelemetry("beta", 0.2, 0.05, 1000, 2000))
    assert story.seen.hosts["alpha"].links == {"beta": LinkState(0.2, 0.05, 1000, 2000)}
    story.tell("alpha", LinkDown("beta"))
    story.tell("alpha", LinkTelemetry("beta", 0.3, 0.05, 1000, 2000))
    assert story.seen.hosts["alpha"].links == {}
    story.tell("alpha", LinkUp("beta"))
    assert story.seen.hosts["alpha"].links == {"beta": LinkState()}


def test_the_log_has_lines_whatever_pieces_programs_write() -> None:
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


def test_what_was_lost_is_counted_by_kind() -> None:
    story = Story()
    story.tell("alpha", EventsDropped("began", 40), lost={"measured": 2})
    story.tell("alpha", lost={"measured": 3})
    assert story.seen.hosts["alpha"].lost == {"began": 40, "measured": 5}


def test_another_life_of_a_host_begins_anew() -> None:
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
def test_another_run_of_the_mission_begins_anew(by_snapshot: bool) -> None:
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


def test_a_host_that_was_started_again_alone_changes_nothing_of_what_others_know() -> None:
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


def test_clocks_that_differ_by_minutes_are_told_and_change_no_age() -> None:
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
    # What geographiclib has there; a metre is 1e-5 degrees.
    assert earth.latitude == pytest.approx(47.40669434, abs=1e-6)
    assert earth.longitude == pytest.approx(8.53897546, abs=2e-6)
    story.tell("beta", DeviceTelemetry("two.fc", {"globalPosition": list(earth)}, 0.0))
    north, east, down = story.seen.vehicles["two"].place
    assert (north, east, down) == (pytest.approx(1000.0), pytest.approx(-500.0), -20.0)


def test_vehicles_that_only_know_the_earth_are_apart_on_a_map_without_an_origin() -> None:
    story = Story()
    here, there = [47.3977, 8.5456, 488.0], [47.3987, 8.5456, 489.0]
    story.tell("alpha", DeviceTelemetry("one.fc", {"globalPosition": here, "position": [0.0, 0.0, 0.0]}, 0.0))
    story.tell("beta", DeviceTelemetry("two.fc", {"globalPosition": there, "position": [0.0, 0.0, 0.0]}, 0.0))
    one, two = (story.seen.vehicles[name].place for name in ("one", "two"))
    assert one == (0.0, 0.0, 0.0)
    assert two.north == pytest.approx(111.2, abs=0.2)
    assert two.down == -1.0


def test_a_vehicle_without_a_position_is_where_its_file_says_or_nowhere() -> None:
    story = Story(Frames(agents={"one": Pose(3.0, 4.0)}))
    story.tell("alpha", DeviceTelemetry("one.fc", {"battery": 0.4}, 0.0), DeviceTelemetry("two.fc", {}, 0.0))
    one, two = (story.seen.vehicles[name] for name in ("one", "two"))
    assert (one.place, one.stated, one.measured) == ((3.0, 4.0, 0.0), True, None)
    assert (two.place, two.stated) == (None, False)


@pytest.mark.parametrize("value", [[1.0], [math.nan, 0.0], [1.0] * 5, "here", True, [200.0, 0.0, 0.0]])
def test_nonsense_of_a_host_is_no_position(value: object) -> None:
    story = Story()
    nonsense = {"position": value, "globalPosition": value, "heading": value, "battery": math.inf}
    if value == [200.0, 0.0, 0.0]:
        del nonsense["position"]
    story.tell("alpha", DeviceTelemetry("one.fc", nonsense, 0.0))  # type: ignore[arg-type]
    vehicle = story.seen.vehicles["one"]
    assert (vehicle.place, vehicle.earth, vehicle.heading, vehicle.battery) == (None, None, None, None)


def test_curves_have_a_point_a_second_and_forget_what_is_old() -> None:
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


def test_hops_a_minute_are_those_of_the_last_one() -> None:
    story = Story()
    for sequence in range(30):
        story.tell("alpha", MigrationArrived("boss", 1, sequence, "beta", 900))
        story.now += 10.0
    story.picture.tick(story.now)
    (hops,) = (curve for curve in story.picture.curves(story.now) if curve.what == "hops")
    assert hops.points[-1][1] == 6.0


def test_a_revision_grows_with_what_is_told_and_not_with_time() -> None:
    story = Story()
    before = story.seen.revision
    story.now += 5.0
    assert story.seen.revision == before
    story.tell("alpha", LinkUp("beta"))
    assert story.seen.revision > before


def test_what_a_snapshot_has_told_the_end_of_changes_nothing_any_more() -> None:
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


def test_a_line_of_the_log_has_the_timestamp_of_its_event() -> None:
    story = Story()
    host = story.hosts["beta"]
    batch = host.batch(5.0, LineLogged("hi"))
    # The clock of beta is 90.25 s behind those of hosts that it has heard of.
    event = replace(batch.events[0], ahead=90_250, tick=3)
    story.picture.feed("beta", replace(batch, events=[event]), story.now, 1.7e9)
    (line,) = story.seen.log
    assert (line.at - host.wall, line.tick) == (pytest.approx(95.25), 3)


def test_no_line_of_a_host_goes_back_when_it_was_started_again_with_an_earlier_clock() -> None:
    story = Story()
    story.tell("alpha", LineLogged("one"))
    host = ScriptedHost(99, wall=5.0)
    story.picture.feed("alpha", host.batch(1.0, LineLogged("two")), story.now + 0.1, 1.7e9)
    first, second = story.seen.log
    assert (first.text, second.text) == ("one", "two")
    assert first.at <= second.at


def test_a_coordinator_that_ended_before_anybody_looked_has_the_hops_that_its_last_host_tells() -> None:
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


def test_the_log_begins_with_what_was_said_before_and_has_nothing_twice() -> None:
    story = Story()
    host = story.hosts["alpha"]
    before = [
        host.event(up, what) for up, what in ((1.0, Printed("boss", "on", "out")), (2.0, LineLogged("up")))
    ]
    story.picture.hold_log()
    story.tell("alpha", Printed("boss", "e\n", "out"), LineLogged("now"))
    assert story.seen.log == ()
    # Whoever reads the past may read on into what comes here as well.
    again = [Event(3, 0.0, 3.0, 0, Printed("boss", "e\n", "out")), Event(4, 0.0, 3.0, 0, LineLogged("now"))]
    past = [("alpha", INCARNATION, event) for event in (*before, *again)]
    story.picture.start_log(past, story.now, 1.7e9 + story.now)
    assert [line.text for line in story.seen.log] == ["up", "one", "now"]
    assert [line.serial for line in story.seen.log] == [1, 2, 3]
    assert story.seen.log[0].age == pytest.approx(story.now + story.aside["alpha"] - 2.0)
    story.tell("alpha", LineLogged("later"))
    assert story.seen.log[-1].text == "later"


def test_of_a_host_that_is_not_heard_itself_all_that_was_said_before_counts() -> None:
    story = Story()
    story.picture.hold_log()
    event = story.hosts["alpha"].event(1.0, LineLogged("up"))
    story.picture.start_log([("alpha", INCARNATION, event)], story.now, event.at + 60.0)
    assert [(line.text, line.age) for line in story.seen.log] == [("up", pytest.approx(60.0))]
    assert not story.seen.hosts["alpha"].linked


def test_what_was_not_told_is_a_line_at_its_place_and_counted_whoever_looks_since_when() -> None:
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


def test_what_a_snapshot_is_newer_than_is_missing_all_the_same() -> None:
    story = Story()
    host = story.hosts["alpha"]
    old = host.batch(1.0, EventsDropped("left", 5))
    story.picture.feed("alpha", host.batch(2.0, snapshot=snapshot("alpha")), story.now, 1.7e9)
    story.picture.feed("alpha", old, story.now, 1.7e9)
    assert story.seen.hosts["alpha"].lost == {"left": 5}


def test_a_coordinator_whose_hops_are_too_many_to_tell_is_where_it_stands() -> None:
    story = Story()
    story.tell("alpha", AgentStarted("boss", 1))
    story.now += 10.0
    story.tell("beta", AgentActivity("boss", "ready", "mission.L", 7, ""))
    boss = story.seen.agents["boss"]
    assert (boss.host, boss.line, boss.to) == ("beta", 7, "")


def test_where_a_coordinator_stands_as_before_is_not_told_again_and_known_all_the_same() -> None:
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


def test_a_host_that_names_more_than_there_can_be_fills_no_memory() -> None:
    story = Story()
    for number in range(MAX_AGENTS + 50):
        story.tell("alpha", AgentStarted(f"a{number}", 1), DeviceTelemetry(f"a{number}.fc", {}, 0.0))
    assert len(story.seen.agents) == MAX_AGENTS
    # Nor does it crowd out the device of another host.
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
def test_only_degrees_of_latitude_and_longitude_are_a_place(name: str, unit: str, is_earth: bool) -> None:
    told = (Quantity(name, "real[]", unit=unit),)
    assert instruments_of(DeviceManifest("Motors", "x", (), told)).earth == (name if is_earth else "")


def test_a_servo_stands_where_its_frame_is_and_one_that_nobody_placed_nowhere() -> None:
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

"""The state of a team from its hosts' events: `TeamView` alone, with the times of the test."""

from __future__ import annotations

import math
from itertools import permutations

import pytest
from dashboard_script import INCARNATION, ScriptedHost, device, resource, snapshot
from picture_story import HOP, ZURICH, Story

from lfield.driver.frame import Pose
from lfield.guard.standstill import UNCONFIRMED
from lfield.mission.bindings import Frames
from lfield.operator.team_model.team_state import LinkState, StopState
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
    HostStopping,
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
    SafeStateConfirmed,
)
from lfield.wire.observer_messages import BundleStatus, EmergencyStopResult, StartStatus, UnlinkableHost


def test_a_host_without_contact_is_shown_as_such() -> None:
    story = Story()
    alpha = story.seen.hosts["alpha"]
    assert (alpha.age, alpha.linked, alpha.problem) == (None, False, "no contact yet")
    assert story.seen.vehicles["one"].position is None
    assert not story.seen.vehicles["one"].fresh


def test_a_snapshot_sets_the_picture() -> None:
    story = Story()
    one = device("one.fc", position=[1.0, 2.0, -3.0], heading=1.5, battery=0.5, mode="GUIDED", armed=True)
    story.tell("alpha", snapshot=snapshot("alpha", one, agents=[resource("one")]))
    vehicle = story.seen.vehicles["one"]
    assert vehicle.position == (1.0, 2.0, -3.0)
    assert vehicle.height == 3.0
    assert (vehicle.heading, vehicle.battery, vehicle.mode, vehicle.armed) == (1.5, 0.5, "GUIDED", True)
    assert vehicle.fresh
    assert vehicle.telemetry_age == 0.0
    assert story.seen.agents["one"].served == 3
    assert story.seen.hosts["alpha"].links == {"beta": LinkState()}
    assert {name: offer.refusal for name, offer in story.seen.offers.items()} == {"one": "", "two": ""}


def test_the_last_state_of_a_dead_host_ages() -> None:
    story = Story()
    story.tell("alpha", snapshot=snapshot("alpha", device("one.fc", battery=0.5)))
    story.tell("alpha", HostStopping("it was told to end"))
    story.picture.on_unlinked("alpha", "no program listens at alpha:8181")
    story.now += 60.0
    alpha, vehicle = story.seen.hosts["alpha"], story.seen.vehicles["one"]
    assert (alpha.linked, alpha.age, alpha.end_reason) == (False, 60.0, "it was told to end")
    assert alpha.problem == "no program listens at alpha:8181"
    assert (vehicle.fresh, vehicle.battery, vehicle.telemetry_age) == (False, 0.5, 60.0)


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
    assert story.seen.vehicles["one"].telemetry_age == pytest.approx(10.0, abs=0.1)


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
    assert (boss.host, boss.target, boss.hops, boss.finished) == ("beta", "", 1, "")
    (hop,) = boss.trail
    assert (hop.number, hop.source, hop.target, hop.duration) == (4, "alpha", "beta", 0.02)
    assert (hop.resource, hop.portal, hop.size) == ("two", "lift", 900)


def test_a_coordinator_is_in_transit_until_it_arrives() -> None:
    story = Story()
    story.tell("alpha", AgentStarted("boss", 1), HOP["left"][1])
    boss = story.seen.agents["boss"]
    assert (boss.host, boss.target, boss.state) == ("alpha", "beta", "on its way")


def test_a_failed_hop_has_its_reason_and_keeps_the_coordinator_in_place() -> None:
    story = Story()
    stayed = MigrationFailed("boss", 1, 4, "beta", "UnreachableResourceException", "no link")
    story.tell("alpha", HOP["left"][1], stayed)
    boss = story.seen.agents["boss"]
    assert (boss.host, boss.target) == ("alpha", "")
    assert boss.trail[0].failure == "UnreachableResourceException: no link"


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
    assert (boss.state, boss.file, boss.line, boss.waits_for) == ("waiting", "mission.L", 12, "two.lift")


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
    assert (stop.is_active, stop.is_complete, stop.by, stop.reason) == (True, False, "anna", "a child")
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
    assert story.seen.stop.is_complete
    story.picture.on_unlinked("beta", "the connection was lost")
    stop = story.seen.stop
    assert (stop.unreached, stop.stopped_before, stop.is_complete) == ({}, {"beta": ("two.fc",)}, False)
    story.tell("alpha", EmergencyStopChanged("anna", "", True))
    stop = story.seen.stop
    assert (stop.is_active, stop.unreached, stop.stopped_before) == (False, {}, {"beta": ("two.fc",)})
    story.tell("beta", EmergencyStopChanged("anna", "", True))
    assert story.seen.stop == StopState()


def test_pauses_and_offers_appear_and_disappear() -> None:
    story = Story()
    story.tell("alpha", PauseChanged("anna"), OfferPublished("two"), OfferWithdrawn("one", "it has died"))
    story.tell("beta", OfferWithdrawn("two", "unreachable"))
    assert story.seen.paused == ("alpha",)
    assert story.seen.offers["one"].refusal == "it has died"
    two = story.seen.offers["two"]
    assert (two.reported_by, two.refusal, two.other_reports) == ("beta", "unreachable", {"alpha": ""})
    story.tell("alpha", PauseChanged("anna", True))
    assert story.seen.paused == ()


def test_a_missing_link_ages() -> None:
    story = Story()
    story.tell("alpha", LinkUp("beta"))
    story.tell("alpha", LinkDown("beta"))
    story.now += 3.0
    alpha = story.seen.hosts["alpha"]
    assert (alpha.links, alpha.unreachable_for) == ({}, {"beta": pytest.approx(3.0, abs=0.01)})


def test_link_figures_are_shown_while_the_link_exists() -> None:
    story = Story()
    story.tell("alpha", LinkUp("beta"), LinkTelemetry("beta", 0.2, 0.05, 1000, 2000))
    assert story.seen.hosts["alpha"].links == {"beta": LinkState(0.2, 0.05, 1000, 2000)}
    story.tell("alpha", LinkDown("beta"))
    story.tell("alpha", LinkTelemetry("beta", 0.3, 0.05, 1000, 2000))
    assert story.seen.hosts["alpha"].links == {}
    story.tell("alpha", LinkUp("beta"))
    assert story.seen.hosts["alpha"].links == {"beta": LinkState()}


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
    assert story.seen.hosts["alpha"].clock_offset == pytest.approx(600.0)
    assert story.seen.vehicles["one"].telemetry_age == 0.0


def test_metres_become_degrees_by_the_origin_and_back() -> None:
    story = Story(Frames(ZURICH))
    story.tell("alpha", DeviceTelemetry("one.fc", {"position": [1000.0, -500.0, -20.0]}, 0.0))
    earth = story.seen.vehicles["one"].geo_position
    assert earth.altitude == 508.0
    # The result of geographiclib; a metre is 1e-5 degrees.
    assert earth.latitude == pytest.approx(47.40669434, abs=1e-6)
    assert earth.longitude == pytest.approx(8.53897546, abs=2e-6)
    story.tell("beta", DeviceTelemetry("two.fc", {"globalPosition": list(earth)}, 0.0))
    north, east, down = story.seen.vehicles["two"].position
    assert (north, east, down) == (pytest.approx(1000.0), pytest.approx(-500.0), -20.0)


def test_vehicles_with_global_positions_only_are_apart_without_an_origin() -> None:
    story = Story()
    here, there = [47.3977, 8.5456, 488.0], [47.3987, 8.5456, 489.0]
    story.tell("alpha", DeviceTelemetry("one.fc", {"globalPosition": here, "position": [0.0, 0.0, 0.0]}, 0.0))
    story.tell("beta", DeviceTelemetry("two.fc", {"globalPosition": there, "position": [0.0, 0.0, 0.0]}, 0.0))
    one, two = (story.seen.vehicles[name].position for name in ("one", "two"))
    assert one == (0.0, 0.0, 0.0)
    assert two.north == pytest.approx(111.2, abs=0.2)
    assert two.down == -1.0


def test_without_a_position_a_vehicle_is_at_its_stated_pose_or_unplaced() -> None:
    story = Story(Frames(agents={"one": Pose(3.0, 4.0)}))
    story.tell("alpha", DeviceTelemetry("one.fc", {"battery": 0.4}, 0.0), DeviceTelemetry("two.fc", {}, 0.0))
    one, two = (story.seen.vehicles[name] for name in ("one", "two"))
    assert (one.position, one.is_position_stated, one.position_age) == ((3.0, 4.0, 0.0), True, None)
    assert (two.position, two.is_position_stated) == (None, False)


@pytest.mark.parametrize("value", [[1.0], [math.nan, 0.0], [1.0] * 5, "here", True, [200.0, 0.0, 0.0]])
def test_invalid_values_of_a_host_are_not_a_position(value: object) -> None:
    story = Story()
    nonsense = {"position": value, "globalPosition": value, "heading": value, "battery": math.inf}
    if value == [200.0, 0.0, 0.0]:
        del nonsense["position"]
    story.tell("alpha", DeviceTelemetry("one.fc", nonsense, 0.0))  # type: ignore[arg-type]
    vehicle = story.seen.vehicles["one"]
    assert (vehicle.position, vehicle.geo_position, vehicle.heading, vehicle.battery) == (
        None,
        None,
        None,
        None,
    )

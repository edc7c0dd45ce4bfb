"""The state of a team from its hosts' events: `TeamView` alone, with the times of the test."""

from __future__ import annotations

import math
from itertools import permutations

import pytest
from dashboard_script import INCARNATION, ScriptedHost, device, resource, snapshot
from picture_scenario import HOP, ZURICH, Scenario

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
    scenario = Scenario()
    alpha = scenario.seen.hosts["alpha"]
    assert (alpha.age, alpha.linked, alpha.problem) == (None, False, "no contact yet")
    assert scenario.seen.vehicles["one"].position is None
    assert not scenario.seen.vehicles["one"].fresh


def test_a_snapshot_sets_the_picture() -> None:
    scenario = Scenario()
    one = device("one.fc", position=[1.0, 2.0, -3.0], heading=1.5, battery=0.5, mode="GUIDED", armed=True)
    scenario.tell("alpha", snapshot=snapshot("alpha", one, agents=[resource("one")]))
    vehicle = scenario.seen.vehicles["one"]
    assert vehicle.position == (1.0, 2.0, -3.0)
    assert vehicle.height == 3.0
    assert (vehicle.heading, vehicle.battery, vehicle.mode, vehicle.armed) == (1.5, 0.5, "GUIDED", True)
    assert vehicle.fresh
    assert vehicle.telemetry_age == 0.0
    assert scenario.seen.agents["one"].served == 3
    assert scenario.seen.hosts["alpha"].links == {"beta": LinkState()}
    assert {name: offer.refusal for name, offer in scenario.seen.offers.items()} == {"one": "", "two": ""}


def test_the_last_state_of_a_dead_host_ages() -> None:
    scenario = Scenario()
    scenario.tell("alpha", snapshot=snapshot("alpha", device("one.fc", battery=0.5)))
    scenario.tell("alpha", HostStopping("SIGTERM received"))
    scenario.picture.on_unlinked("alpha", "no program listens at alpha:8181")
    scenario.now += 60.0
    alpha, vehicle = scenario.seen.hosts["alpha"], scenario.seen.vehicles["one"]
    assert (alpha.linked, alpha.age, alpha.end_reason) == (False, 60.0, "SIGTERM received")
    assert alpha.problem == "no program listens at alpha:8181"
    assert (vehicle.fresh, vehicle.battery, vehicle.telemetry_age) == (False, 0.5, 60.0)


def test_telemetry_has_the_age_it_reports() -> None:
    scenario = Scenario()
    scenario.tell("alpha", DeviceTelemetry("one.fc", {"battery": 0.4}, 2.0))
    scenario.now += 1.0
    reading = scenario.seen.vehicles["one"].devices[0].readings["battery"]
    assert (reading.value, reading.age) == (0.4, 3.0)


def test_a_delayed_batch_is_shown_with_its_age() -> None:
    scenario = Scenario()
    scenario.tell("alpha", LinkUp("beta"))
    late = scenario.hosts["alpha"].batch(
        scenario.now + 1.0 - 50.0, DeviceTelemetry("one.fc", {"battery": 0.4}, 0.0)
    )
    scenario.now += 11.0
    scenario.picture.feed("alpha", late, scenario.now, 1.7e9)
    assert scenario.seen.vehicles["one"].telemetry_age == pytest.approx(10.0, abs=0.1)


@pytest.mark.parametrize("order", list(permutations(HOP)))
def test_a_hop_ends_at_its_target_in_any_order_of_reports(order: tuple[str, ...]) -> None:
    # The events of one host keep their order.
    if order.index("left") > order.index("hopped"):
        return
    scenario = Scenario()
    scenario.tell("alpha", AgentStarted("boss", 1))
    for part in order:
        scenario.tell(*HOP[part])
    boss = scenario.seen.coordinators["boss"]
    assert (boss.host, boss.target, boss.hops, boss.finished) == ("beta", "", 1, "")
    (hop,) = boss.trail
    assert (hop.number, hop.source, hop.target, hop.duration) == (4, "alpha", "beta", 0.02)
    assert (hop.resource, hop.portal, hop.size) == ("two", "lift", 900)


def test_a_coordinator_is_in_transit_until_it_arrives() -> None:
    scenario = Scenario()
    scenario.tell("alpha", AgentStarted("boss", 1), HOP["left"][1])
    boss = scenario.seen.agents["boss"]
    assert (boss.host, boss.target, boss.state) == ("alpha", "beta", "on its way")


def test_a_failed_hop_has_its_reason_and_keeps_the_coordinator_in_place() -> None:
    scenario = Scenario()
    stayed = MigrationFailed("boss", 1, 4, "beta", "UnreachableResourceException", "no link")
    scenario.tell("alpha", HOP["left"][1], stayed)
    boss = scenario.seen.agents["boss"]
    assert (boss.host, boss.target) == ("alpha", "")
    assert boss.trail[0].failure == "UnreachableResourceException: no link"


def test_late_reports_of_a_hop_do_not_move_a_coordinator() -> None:
    scenario = Scenario()
    scenario.tell(
        "beta",
        MigrationArrived("boss", 1, 4, "alpha", 900),
        MigrationStarted("boss", 1, 5, "alpha", "one", "lift", 900),
    )
    scenario.tell("alpha", MigrationArrived("boss", 1, 5, "beta", 900))
    scenario.tell("alpha", HOP["left"][1], HOP["hopped"][1])
    boss = scenario.seen.agents["boss"]
    assert (boss.host, boss.hops) == ("alpha", 2)
    assert [hop.number for hop in boss.trail] == [4, 5]


def test_the_position_of_a_coordinator_is_that_of_the_host_that_has_it() -> None:
    scenario = Scenario()
    scenario.tell(
        "alpha", AgentStarted("boss", 1), AgentActivity("boss", "waiting", "mission.L", 12, "two.lift")
    )
    scenario.tell("beta", AgentActivity("boss", "ready", "mission.L", 3, ""))
    boss = scenario.seen.agents["boss"]
    assert (boss.state, boss.file, boss.line, boss.waits_for) == ("waiting", "mission.L", 12, "two.lift")


def test_a_superseded_start_leaves_the_coordinator_to_the_earlier_one() -> None:
    scenario = Scenario()
    scenario.tell("alpha", AgentStarted("boss", 2))
    scenario.tell("beta", AgentStarted("boss", 1))
    assert scenario.seen.agents["boss"].host == "alpha"
    scenario.tell(
        "alpha",
        CoordinatorSuperseded("boss", 2, "start 1 is alive"),
        AgentFinished("boss", 2, "superseded", ""),
    )
    assert scenario.seen.agents["boss"].finished == "superseded"
    scenario.tell("beta", MigrationArrived("boss", 1, 3, "alpha", 900))
    boss = scenario.seen.agents["boss"]
    assert (boss.host, boss.generation, boss.finished) == ("beta", 1, "")


def test_a_snapshot_sets_the_hosts_of_coordinators() -> None:
    scenario = Scenario()
    copies = [CoordinatorState("boss", 2, 9, 5, "IN DOUBT", "beta", "", "beta is gone")]
    status = snapshot("alpha")
    scenario.tell("alpha", snapshot=type(status)(**{**_fields(status), "coordinators": copies}))
    assert scenario.seen.agents["boss"].doubt == "beta is gone"
    copies = [CoordinatorState("boss", 2, 9, 5, "RUN")]
    status = snapshot("beta")
    scenario.tell("beta", snapshot=type(status)(**{**_fields(status), "coordinators": copies}))
    boss = scenario.seen.agents["boss"]
    assert (boss.host, boss.doubt, boss.hops, boss.generation) == ("beta", "", 5, 2)


def test_a_snapshot_has_the_bundle_the_delayed_start_and_refused_hosts() -> None:
    scenario = Scenario()
    status = snapshot("alpha")
    more = {
        "bundle": BundleStatus(bytes.fromhex("5cde09b1f2a37c4400"), "anna", 0.0),
        "start": StartStatus(["boss"], ["beta"], [], ""),
        "refused": [UnlinkableHost("beta", "another bundle", b"\x77")],
    }
    scenario.tell("alpha", snapshot=type(status)(**{**_fields(status), **more}))
    host = scenario.seen.hosts["alpha"]
    assert host.bundle == "5cde09b1f2a37c44"
    assert host.waits_for == ("beta",)
    assert host.refused == {"beta": "another bundle"}


def _fields(status: object) -> dict[str, object]:
    return {name: getattr(status, name) for name in status.__struct_fields__}  # type: ignore[attr-defined]


def test_a_latch_is_shown_confirmed_at_rest_and_released() -> None:
    scenario = Scenario()
    scenario.tell("alpha", DeviceLatched("one.fc", "land", "the link is lost"))
    (fc,) = scenario.seen.vehicles["one"].devices
    assert (fc.latched, fc.confirmed, fc.at_rest) == ("the link is lost", False, False)
    scenario.tell(
        "alpha", SafeStateConfirmed("one.fc", "land", "the link is lost"), DeviceMoving("one.fc", "3 m high")
    )
    (fc,) = scenario.seen.vehicles["one"].devices
    assert (fc.confirmed, fc.moving, fc.at_rest) == (True, "3 m high", False)
    scenario.tell("alpha", DeviceMoving("one.fc", ""))
    assert scenario.seen.vehicles["one"].devices[0].at_rest
    scenario.tell("alpha", DeviceReleased("one.fc"))
    assert not scenario.seen.vehicles["one"].latched


def test_a_snapshot_before_the_safe_state_confirms_nothing() -> None:
    scenario = Scenario()
    scenario.tell("alpha", snapshot=snapshot("alpha", device("one.fc", "the link is lost", UNCONFIRMED)))
    (fc,) = scenario.seen.vehicles["one"].devices
    assert (fc.latched, fc.confirmed, fc.moving) == ("the link is lost", False, "")


def test_a_stop_shows_confirmed_and_unconfirmed_devices() -> None:
    scenario = Scenario()
    scenario.tell(
        "alpha", EmergencyStopChanged("anna", "a child"), DeviceLatched("one.fc", "land", "a child")
    )
    scenario.tell("beta", LinkUp("alpha"))
    stop = scenario.seen.stop
    assert (stop.is_active, stop.is_complete, stop.by, stop.reason) == (True, False, "anna", "a child")
    assert stop.unconfirmed == {"one.fc": "its safe state is not confirmed yet"}
    assert stop.unreached == {"beta": "the host has not confirmed the stop"}
    scenario.tell("alpha", SafeStateConfirmed("one.fc", "land", "a child"))
    scenario.tell("beta", EmergencyStopChanged("anna", "a child"))
    scenario.picture.on_answer(0, "beta", EmergencyStopResult({"two.fc": "its port is gone"}))
    stop = scenario.seen.stop
    assert (stop.confirmed, stop.unconfirmed) == (("one.fc",), {"two.fc": "its port is gone"})
    scenario.tell(
        "beta", DeviceLatched("two.fc", "land", "a child"), SafeStateConfirmed("two.fc", "land", "a child")
    )
    assert scenario.seen.stop.is_complete
    scenario.picture.on_unlinked("beta", "the connection was lost")
    stop = scenario.seen.stop
    assert (stop.unreached, stop.stopped_before, stop.is_complete) == ({}, {"beta": ("two.fc",)}, False)
    scenario.tell("alpha", EmergencyStopChanged("anna", "", True))
    stop = scenario.seen.stop
    assert (stop.is_active, stop.unreached, stop.stopped_before) == (False, {}, {"beta": ("two.fc",)})
    scenario.tell("beta", EmergencyStopChanged("anna", "", True))
    assert scenario.seen.stop == StopState()


def test_pauses_and_offers_appear_and_disappear() -> None:
    scenario = Scenario()
    scenario.tell("alpha", PauseChanged("anna"), OfferPublished("two"), OfferWithdrawn("one", "it has died"))
    scenario.tell("beta", OfferWithdrawn("two", "unreachable"))
    assert scenario.seen.paused == ("alpha",)
    assert scenario.seen.offers["one"].refusal == "it has died"
    two = scenario.seen.offers["two"]
    assert (two.reported_by, two.refusal, two.other_reports) == ("beta", "unreachable", {"alpha": ""})
    scenario.tell("alpha", PauseChanged("anna", True))
    assert scenario.seen.paused == ()


def test_a_missing_link_ages() -> None:
    scenario = Scenario()
    scenario.tell("alpha", LinkUp("beta"))
    scenario.tell("alpha", LinkDown("beta"))
    scenario.now += 3.0
    alpha = scenario.seen.hosts["alpha"]
    assert (alpha.links, alpha.unreachable_for) == ({}, {"beta": pytest.approx(3.0, abs=0.01)})


def test_link_figures_are_shown_while_the_link_exists() -> None:
    scenario = Scenario()
    scenario.tell("alpha", LinkUp("beta"), LinkTelemetry("beta", 0.2, 0.05, 1000, 2000))
    assert scenario.seen.hosts["alpha"].links == {"beta": LinkState(0.2, 0.05, 1000, 2000)}
    scenario.tell("alpha", LinkDown("beta"))
    scenario.tell("alpha", LinkTelemetry("beta", 0.3, 0.05, 1000, 2000))
    assert scenario.seen.hosts["alpha"].links == {}
    scenario.tell("alpha", LinkUp("beta"))
    assert scenario.seen.hosts["alpha"].links == {"beta": LinkState()}


@pytest.mark.parametrize("by_snapshot", [False, True])
def test_another_run_of_the_mission_starts_with_an_empty_state(by_snapshot: bool) -> None:
    scenario = Scenario()
    scenario.tell("alpha", AgentStarted("boss", 2))
    for sequence in range(1, 41):
        of, to = ("alpha", "beta") if sequence % 2 else ("beta", "alpha")
        scenario.tell(of, MigrationStarted("boss", 2, sequence, to, "two", "lift", 900))
        scenario.tell(to, MigrationArrived("boss", 2, sequence, of, 900))
    scenario.tell("alpha", AgentFinished("boss", 2, "done", ""))
    for host in scenario.hosts:
        scenario.picture.on_unlinked(host, "the host closed the link")
    scenario.hosts = {"alpha": ScriptedHost(INCARNATION + 10), "beta": ScriptedHost(INCARNATION + 11)}
    scenario.now += 20.0
    if by_snapshot:
        status = snapshot("alpha")
        copies = [CoordinatorState("boss", 1, 0, 0, "RUN")]
        scenario.tell("alpha", snapshot=type(status)(**{**_fields(status), "coordinators": copies}))
    else:
        scenario.tell("alpha", AgentStarted("boss", 1))
    boss = scenario.seen.agents["boss"]
    assert (boss.host, boss.generation, boss.hops, boss.finished, boss.trail) == ("alpha", 1, 0, "", ())
    scenario.tell("alpha", MigrationStarted("boss", 1, 1, "beta", "two", "lift", 900))
    scenario.tell("beta", MigrationArrived("boss", 1, 1, "alpha", 900))
    scenario.tell("alpha", MigrationConfirmed("boss", 1, 1, "beta", 0.02))
    boss = scenario.seen.agents["boss"]
    assert (boss.host, boss.hops, [hop.number for hop in boss.trail]) == ("beta", 1, [1])


def test_a_restart_of_one_host_does_not_change_the_state_of_others() -> None:
    scenario = Scenario()
    scenario.tell("alpha", AgentStarted("boss", 1), HOP["left"][1])
    scenario.tell(
        "beta", HOP["came"][1], MigrationStarted("boss", 1, 5, "alpha", "one", "lift", 900), LinkUp("alpha")
    )
    scenario.tell("beta", MigrationFailed("boss", 1, 5, "alpha", "", "no link"))
    scenario.hosts["alpha"] = ScriptedHost(INCARNATION + 1)
    scenario.tell("alpha", HOP["left"][1])
    boss = scenario.seen.agents["boss"]
    assert (boss.host, [hop.number for hop in boss.trail]) == ("beta", [4, 5])


def test_clock_differences_are_shown_and_change_no_age() -> None:
    scenario = Scenario()
    scenario.hosts["alpha"].wall = 1.7e9 + 600.0 - (scenario.now - 50.0)
    scenario.tell("alpha", DeviceTelemetry("one.fc", {"battery": 0.4}, 0.0))
    assert scenario.seen.hosts["alpha"].clock_offset == pytest.approx(600.0)
    assert scenario.seen.vehicles["one"].telemetry_age == 0.0


def test_metres_become_degrees_by_the_origin_and_back() -> None:
    scenario = Scenario(Frames(ZURICH))
    scenario.tell("alpha", DeviceTelemetry("one.fc", {"position": [1000.0, -500.0, -20.0]}, 0.0))
    earth = scenario.seen.vehicles["one"].geo_position
    assert earth.altitude == 508.0
    # The result of geographiclib; a metre is 1e-5 degrees.
    assert earth.latitude == pytest.approx(47.40669434, abs=1e-6)
    assert earth.longitude == pytest.approx(8.53897546, abs=2e-6)
    scenario.tell("beta", DeviceTelemetry("two.fc", {"globalPosition": list(earth)}, 0.0))
    north, east, down = scenario.seen.vehicles["two"].position
    assert (north, east, down) == (pytest.approx(1000.0), pytest.approx(-500.0), -20.0)


def test_vehicles_with_global_positions_only_are_apart_without_an_origin() -> None:
    scenario = Scenario()
    here, there = [47.3977, 8.5456, 488.0], [47.3987, 8.5456, 489.0]
    scenario.tell(
        "alpha", DeviceTelemetry("one.fc", {"globalPosition": here, "position": [0.0, 0.0, 0.0]}, 0.0)
    )
    scenario.tell(
        "beta", DeviceTelemetry("two.fc", {"globalPosition": there, "position": [0.0, 0.0, 0.0]}, 0.0)
    )
    one, two = (scenario.seen.vehicles[name].position for name in ("one", "two"))
    assert one == (0.0, 0.0, 0.0)
    assert two.north == pytest.approx(111.2, abs=0.2)
    assert two.down == -1.0


def test_without_a_position_a_vehicle_is_at_its_stated_pose_or_unplaced() -> None:
    scenario = Scenario(Frames(agents={"one": Pose(3.0, 4.0)}))
    scenario.tell(
        "alpha", DeviceTelemetry("one.fc", {"battery": 0.4}, 0.0), DeviceTelemetry("two.fc", {}, 0.0)
    )
    one, two = (scenario.seen.vehicles[name] for name in ("one", "two"))
    assert (one.position, one.is_position_stated, one.position_age) == ((3.0, 4.0, 0.0), True, None)
    assert (two.position, two.is_position_stated) == (None, False)


@pytest.mark.parametrize("value", [[1.0], [math.nan, 0.0], [1.0] * 5, "here", True, [200.0, 0.0, 0.0]])
def test_invalid_values_of_a_host_are_not_a_position(value: object) -> None:
    scenario = Scenario()
    nonsense = {"position": value, "globalPosition": value, "heading": value, "battery": math.inf}
    if value == [200.0, 0.0, 0.0]:
        del nonsense["position"]
    scenario.tell("alpha", DeviceTelemetry("one.fc", nonsense, 0.0))  # type: ignore[arg-type]
    vehicle = scenario.seen.vehicles["one"]
    assert (vehicle.position, vehicle.geo_position, vehicle.heading, vehicle.battery) == (
        None,
        None,
        None,
        None,
    )

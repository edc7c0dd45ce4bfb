"""Calls of persons under stops, reservations, leases and dead-man's switches, as those of coordinators."""

from __future__ import annotations

from pathlib import Path

from calling_person import CallingPerson, fleet_of, log_of

from lfield.wire.observer_messages import EmergencyStop, with_epoch

VEHICLE = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal climb(real height) { fc.takeoff(height); print("climbed"); }
    portal slow(real seconds) { fc.takeoff(5.0); sleep(seconds); print("done"); }
    portal fine() emit int { return 1; }
    portal stay(real seconds) { sleep(seconds); }
}
coordinator Holder {
    init(string[] arg) { HOLD }
}
"""
DEPLOYMENT = "//Post:post@alpha\n//Holder:holder@alpha\n"
IDLE = "sleep(10000.0);"


def vehicle(folder: Path, hold: str = IDLE, deployment: str = DEPLOYMENT, **files: str):
    return fleet_of(folder, VEHICLE.replace("HOLD", hold), deployment, **files)


def test_an_emergency_stop_makes_device_calls_of_persons_fail(tmp_path: Path) -> None:
    fleet = vehicle(tmp_path)
    anna = CallingPerson(fleet)
    anna.enter(with_epoch(EmergencyStop(b"s" * 16, "fire"), fleet.runs["alpha"].core.orders.epochs))
    fleet.run(2.0)
    found = anna.result("climb", 5.0)
    assert (found.outcome, found.kind) == ("thrown", "DeviceException")
    assert anna.value("fine") == 1
    assert "climbed" not in log_of(fleet)


RESERVES = 'Post p = findPost()[0]; reserve (p) { print("held"); sleep(20.0); } print("free"); sleep(1e4);'


def test_a_call_of_a_reserved_resource_waits_until_its_limit(tmp_path: Path) -> None:
    fleet = vehicle(tmp_path, RESERVES, devices="reservations: {wait: 60}\n")
    assert "held" in log_of(fleet)
    anna = CallingPerson(fleet)
    anna.call("fine", limit=100.0)
    early = anna.result("fine", limit=2.0)
    assert (early.outcome, early.kind) == ("thrown", "TimeLimitException")
    assert "free" not in log_of(fleet)
    fleet.run(25.0)
    assert "free" in log_of(fleet)
    assert [found.outcome for found in anna.results] == ["thrown", "returned"]


def test_without_a_wait_a_reserved_resource_refuses_at_once(tmp_path: Path) -> None:
    fleet = vehicle(tmp_path, RESERVES, devices="reservations: {wait: 0}\n")
    found = CallingPerson(fleet).result("fine")
    assert (found.outcome, found.kind) == ("thrown", "ReservedException")


def test_a_pause_ends_the_wait_for_a_reservation(tmp_path: Path) -> None:
    fleet = vehicle(tmp_path, RESERVES, devices="reservations: {wait: 60}\n")
    anna = CallingPerson(fleet)
    anna.call("fine", limit=100.0)
    fleet.run(1.0)
    anna.pause()
    fleet.run(1.0)
    assert [(found.outcome, found.kind) for found in anna.results] == [("thrown", "RestartException")]


def test_a_coordinator_reserves_only_after_the_call_of_a_person(tmp_path: Path) -> None:
    hold = RESERVES.replace("Post p", "sleep(8.0); Post p")
    fleet = vehicle(tmp_path, hold, devices="reservations: {wait: 60}\n")
    anna = CallingPerson(fleet)
    anna.call("stay", 10.0, limit=100.0)
    fleet.run(8.0)
    assert "held" not in log_of(fleet)
    fleet.run(4.0)
    assert "held" in log_of(fleet)
    assert [found.outcome for found in anna.results] == ["returned"]


def test_the_dead_mans_switch_counts_a_person_while_a_call_runs(tmp_path: Path) -> None:
    binding = (
        'agents:\n  post:\n    devices:\n      fc:\n        driver: mavlink\n        endpoint: "sim:"\n'
        "        without_policy: {after: 5, do: land}\n"
    )
    fleet = vehicle(tmp_path, devices=binding)
    anna = CallingPerson(fleet)
    anna.call("slow", 15.0, limit=100.0)
    fleet.run(18.0)
    device = fleet.runs["alpha"].host.guards
    assert not device.latched.get("post.fc")
    fleet.run(15.0)
    assert [found.outcome for found in anna.results] == ["returned"]
    assert "person anna" in device.latched["post.fc"]


def test_the_death_of_the_resource_ends_the_call(tmp_path: Path) -> None:
    program = """
    resource Post {
        init(string[] arg) { sleep(8.0); int[] none = new int[1]; none[3] = 1; }
        portal rest() { sleep(30.0); }
    }
    coordinator Idle { init(string[] arg) { sleep(10000.0); } }
    """
    fleet = fleet_of(tmp_path, program, "//Post:post@alpha\n//Idle:idle@alpha\n")
    anna = CallingPerson(fleet)
    anna.call("rest", limit=100.0)
    fleet.run(6.0)
    assert [found.kind for found in anna.results] == ["UnreachableResourceException"]
    assert anna.result("rest").kind == "UnreachableResourceException"
    assert fleet.runs["alpha"].core.machine.person_portals.running == []


LEASED = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal climb(real height) { fc.takeoff(height); print("climbed"); }
    portal slow(real seconds) { fc.takeoff(5.0); sleep(seconds); fc.land(); print("done"); }
    portal fine() emit int { return 1; }
}
resource Far { init(string[] arg) { } portal go() { } }
coordinator Safe {
    init(string[] arg) {
        heartbeatInterval(1000);
        Far far = findFar()[0];
        while (true) { far.go(); sleep(1.0); }
    }
}
"""


def test_a_host_without_a_lease_refuses_calls_and_ends_pending_ones(tmp_path: Path) -> None:
    fleet = fleet_of(
        tmp_path,
        LEASED,
        "//Post:post@alpha\n//Far:far@bravo\n//Far:more@charlie\n//Safe:safe@bravo\n",
    )
    core = fleet.runs["alpha"].core
    assert core.leases.leased_agents == {"safe"}
    fleet.run(10.0)
    anna = CallingPerson(fleet)
    assert anna.value("fine") == 1
    anna.call("slow", 60.0, limit=100.0)
    fleet.run(10.0)
    fleet.cut("alpha", "bravo")
    fleet.cut("alpha", "charlie")
    fleet.run(20.0)
    assert [found.kind for found in anna.results[1:]] == ["RestartException"]
    assert fleet.runs["alpha"].host.guards.latched["post.fc"]
    assert anna.result("fine").kind == "paused"

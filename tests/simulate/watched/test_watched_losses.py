"""The events of lost hosts, links and coordinators, and of changed offers. In virtual time."""

from __future__ import annotations

from pathlib import Path
from secrets import token_bytes

import pytest
from event_watcher import EventWatcher, chain, watch
from msgspec import structs

from lfield.driver.binding import OrphanPolicy
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.simulate.host_fleet import Fleet
from lfield.wire import events
from lfield.wire.observer_messages import EmergencyStop
from lfield.wire.subscription_messages import Subscribe

PROGRAM = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal climb(real height) { fc.takeoff(height); }
}
coordinator Walker {
    init(string[] arg) {
        INTERVAL
        Post[] posts = findPost();
        int n = 0;
        while (true) {
            try { posts[n % posts.length()].climb(5.0); }
            catch (UnreachableResourceException away) { print("away"); }
            catch (RestartException told) { print("told"); }
            catch (DeviceException held) { print("held"); }
            n = n + 1;
            sleep(0.2);
        }
    }
}
"""
TEAM = "//Post:a@alpha\n//Post:b@bravo\n//Post:c@charlie\n//Walker:walker@alpha\n"
HOISTS = """
resource Hoist {
    Mavlink fc;
    init(string[] arg) { while (true) yield(); }
    portal lift(real height) emit real { return height; }
    portal lower(real height) emit real { return height; }
}
coordinator Foreman { init(string[] arg) { Lift[] who = findLift(); sleep(1000.0); } }
"""
CAPABILITIES = """
registry: 1
providers:
  Hoist:
    nominal: {payload: 2.0}
    live: {battery: fc.battery}
    serves: {Lift: {}}
"""


def mission(folder: Path, interval: str = "", team: str = TEAM) -> Mission:
    (folder / "mission.L").write_text(PROGRAM.replace("INTERVAL", interval))
    (folder / "mission.dL").write_text(team)
    return load_mission(folder / "mission.dL", simulate=True)


def holder(fleet: Fleet, *others: str) -> str:
    """Run until the coordinator runs on a host that is none of these."""
    for _ in range(2000):
        for name, life in fleet.runs.items():
            agent = life.core.machine.agents.get("walker")
            if name not in others and agent is not None and not agent.frozen:
                return name
        fleet.run(0.05)
    raise AssertionError("the coordinator runs on no host")


@pytest.mark.few(0)
def test_the_host_that_recovers_a_coordinator_reports_it(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path, "heartbeatInterval(3.0);"), 1)
    fleet.run(20.0)
    lost = holder(fleet)
    left = {name: watch(fleet, name) for name in fleet.runs if name != lost}
    fleet.run(0.2)
    fleet.lose(lost)
    fleet.run(60.0)
    found = [
        (name, event) for name, watcher in left.items() for event in watcher.of(events.CoordinatorRecovered)
    ]
    ((name, recovered),) = found
    assert isinstance(recovered.what, events.CoordinatorRecovered)
    agent = fleet.runs[name].core.machine.agents.get("walker")
    later = left[name].of(events.MigrationArrived) + left[name].of(events.MigrationStarted)
    assert recovered.what.agent == "walker"
    assert agent is not None or any(event.number > recovered.number for event in later)
    assert any(
        event.what == events.LinkDown(lost)
        for watcher in left.values()
        for event in watcher.of(events.LinkDown)
    )


def test_a_coordinator_that_cannot_leave_stays_with_an_exception(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path, team="//Post:a@alpha\n//Post:b@bravo\n//Walker:walker@alpha\n"), 1)
    fleet.run(8.0)
    assert holder(fleet, "bravo") == "alpha"
    watcher = watch(fleet, "alpha")
    fleet.crash("bravo")
    fleet.run(40.0)
    stayed = watcher.of(events.MigrationFailed)
    assert stayed
    what = stayed[0].what
    assert isinstance(what, events.MigrationFailed)
    assert (what.agent, what.to, what.exception) == ("walker", "bravo", "UnreachableResourceException")
    assert "bravo" in what.reason
    printed = next(e for e in watcher.of(events.Printed) if e.number > stayed[0].number)
    assert printed.what == events.Printed("walker", "away")
    assert printed.cause == stayed[0].number


@pytest.mark.few(0)
def test_an_abandoned_device_is_made_safe_with_its_cause(tmp_path: Path) -> None:
    loaded = mission(tmp_path)
    bound = {
        agent: {name: structs.replace(d, without_policy=OrphanPolicy(10.0, "hold")) for name, d in of.items()}
        for agent, of in loaded.bindings.devices.items()
    }
    fleet = Fleet(loaded.with_bindings(structs.replace(loaded.bindings, devices=bound)), 1)
    fleet.run(12.0)
    lost = holder(fleet)
    watchers = {name: watch(fleet, name) for name in fleet.runs if name != lost}
    fleet.run(0.1)
    fleet.lose(lost)
    fleet.run(60.0)
    latched = [
        (watcher, event) for watcher in watchers.values() for event in watcher.of(events.DeviceLatched)
    ]
    assert latched
    for watcher, event in latched:
        assert isinstance(event.what, events.DeviceLatched)
        assert "no coordinator that used it (walker" in event.what.reason
        led = watcher.by_number().get(event.cause)
        assert led is None or led.what.agent == "walker"  # type: ignore[union-attr]
        assert event.cause > 0


@pytest.mark.parametrize("asks_for_capabilities", [True, False])
def test_changed_offers_are_reported_with_their_cause(tmp_path: Path, asks_for_capabilities: bool) -> None:
    if asks_for_capabilities:
        (tmp_path / "mission.L").write_text(HOISTS)
        (tmp_path / "mission.capabilities.yaml").write_text(CAPABILITIES)
    else:
        (tmp_path / "mission.L").write_text(HOISTS.replace("Lift[] who = findLift();", ""))
    (tmp_path / "mission.dL").write_text("//Hoist:one@alpha\n//Hoist:two@bravo\n//Foreman:foreman@alpha\n")
    fleet = Fleet(load_mission(tmp_path / "mission.dL", simulate=True), 1)
    fleet.run(10.0)
    watcher = watch(fleet, "alpha")
    fleet.run(3.0)
    snapshot = watcher.batches[0].snapshot
    assert snapshot is not None
    assert [(entry.agent, entry.refusal) for entry in snapshot.directory] == [("one", ""), ("two", "")]
    assert not watcher.of(events.OfferWithdrawn) + watcher.of(events.OfferPublished)
    watcher.order(EmergencyStop(token_bytes(16), "why"))
    fleet.crash("bravo")
    fleet.run(5.0)
    withdrawn = {event.what.agent: event for event in watcher.of(events.OfferWithdrawn)}  # type: ignore[union-attr]
    assert withdrawn.keys() == {"one", "two"}
    assert "stopped" in chain(watcher, withdrawn["one"])
    assert chain(watcher, withdrawn["two"]) == ["unlinked"]
    assert "unreachable" in withdrawn["two"].what.reason  # type: ignore[union-attr]
    fleet.boot("bravo")
    fleet.run(8.0)
    (offered,) = watcher.of(events.OfferPublished)
    assert offered.what == events.OfferPublished("two")
    assert chain(watcher, offered) == ["linked"]


def test_a_coordinator_continues_from_the_journal_of_its_host(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path, team="//Post:a@alpha\n//Post:b@bravo\n//Walker:walker@alpha\n"), 3)
    fleet.run(10.0)
    assert holder(fleet, "bravo") == "alpha"
    fleet.crash("alpha")
    fleet.boot("alpha")
    fleet.run(0.001)
    watcher = watch(fleet, "alpha", Subscribe(1))
    fleet.run(8.0)
    assert watcher.states[0].number == 1
    (start,) = [e for e in watcher.of(events.AgentStarted) if e.what.agent == "walker"]  # type: ignore[union-attr]
    assert start.what == events.AgentStarted("walker", 1, kept=True)


def reads_all(watcher: EventWatcher) -> bool:
    """Whether the watcher has received every event."""
    numbers = [event.number for event in watcher.states]
    return numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def test_no_event_is_missing_under_faults_of_links_and_hosts(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path, "heartbeatInterval(3.0);"), 5)
    fleet.run(8.0)
    watcher = watch(fleet, "alpha", Subscribe(telemetry=10.0))
    for _ in range(6):
        fleet.cut("alpha", "bravo")
        fleet.run(3.0)
        fleet.heal("alpha", "bravo")
        fleet.crash("charlie")
        fleet.run(1.0)
        fleet.boot("charlie")
        fleet.run(4.0)
    assert reads_all(watcher)
    assert len(watcher.of(events.LinkDown)) >= 6
    assert not any("state" in batch.lost for batch in watcher.batches)

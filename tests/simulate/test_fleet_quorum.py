"""Another host recovers a coordinator of a lost host, without a second acting copy. Virtual time."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec import structs

from lfield import exit_status
from lfield.journal.records import RecordKey
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.replication.transfer.coordinator_copies import CoordinatorCopy
from lfield.simulate.host_fleet import Fleet, FleetOptions
from lfield.vm.memory.layout import HEADER_WORDS

PROGRAM = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal stamp(int n) { print("stamp " + i2s(n)); sleep(0.3); }
    portal free() { fc.release(); }
    portal climb(int n) { print("climb " + i2s(n)); fc.takeoff(1.0 * n); print("up " + i2s(n)); }
}
coordinator Walker {
    init(string[] arg) {
        heartbeatInterval(INTERVAL);
        Post[] posts = findPost();
        boolean[] gone = new boolean[posts.length()];
        for (int n = 0; n < 60; n = n + 1) {
            int tries = 3;
            if (gone[n % posts.length()]) tries = 0;
            while (tries > 0) {
                try {
                    posts[n % posts.length()].CALL(n);
                    tries = 0;
                } catch (RestartException again) {
                    print("told at " + i2s(n) + ": " + again.message());
                    tries = tries - 1;
                } catch (UnreachableResourceException away) {
                    print("away at " + i2s(n) + ": " + away.message());
                    gone[n % posts.length()] = true;
                    tries = 0;
                } catch (Exception refused) {
                    print("refused at " + i2s(n) + ": " + refused.message());
                    tries = tries - 1;
                    sleep(0.2);
                }
            }
        }
        print("complete");
    }
}
"""
TEAM = "//Post:a@alpha\n//Post:b@bravo\n//Post:c@charlie\n//Walker:walker@alpha\n"
INTERVAL, LEASE = 3.0, 2.0


def mission(folder: Path, call: str = "stamp", team: str = TEAM, interval: float = INTERVAL) -> Mission:
    (folder / "mission.L").write_text(PROGRAM.replace("INTERVAL", str(interval)).replace("CALL", call))
    (folder / "mission.dL").write_text(team)
    return load_mission(folder / "mission.dL", simulate=True)


def logged(fleet: Fleet, what: str) -> list[tuple[float, str, str]]:
    return [line for line in fleet.log if what in line[2]]


def run_until(fleet: Fleet, what: str, within: float) -> float:
    """Wait for the first line with this text; returns its time, fails after `within` seconds."""
    end = fleet.now + within
    while fleet.now < end:
        if found := logged(fleet, what):
            return found[0][0]
        fleet.run(0.1)
    raise AssertionError(
        f"{what!r} was not logged within {within} s:\n" + "".join(x[2] for x in fleet.log[-20:])
    )


def holder(fleet: Fleet) -> str:
    """The host of the walker, once it is not in a hop."""
    while True:
        agents = {name: life.core.machine.agents.get("walker") for name, life in fleet.runs.items()}
        found = [name for name, agent in agents.items() if agent is not None and not agent.frozen]
        if len(found) == 1:
            return found[0]
        fleet.run(0.01)


@pytest.mark.few(0)
def test_a_home_that_is_no_member_starts_and_ends_coordinators_under_leases(tmp_path: Path) -> None:
    (tmp_path / "mission.devices.yaml").write_text("recovery: {members: [bravo, charlie, watch]}\n")
    team = TEAM.replace("//Walker", "//@watch\n//Walker")
    run_until(Fleet(mission(tmp_path, team=team), 1), "complete", 60.0)


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(6))
def test_the_team_continues_without_the_host_that_has_the_coordinator(tmp_path: Path, seed: int) -> None:
    fleet = Fleet(mission(tmp_path), seed)
    run_until(fleet, f"stamp {7 + seed}\n", 30.0)
    lost, at = holder(fleet), fleet.now
    fleet.power_off(lost)
    recovered_at = run_until(fleet, "was recovered on", 20.0)
    # The walker may have made one more call before it hopped to the lost host.
    last = max([at, *(when + 0.35 for when, _, _ in logged(fleet, "stamp ") if when < recovered_at)])
    assert recovered_at - last <= INTERVAL + 3.0
    run_until(fleet, "complete", 90.0)
    stamped = [text.strip() for _, _, text in logged(fleet, "stamp ")]
    assert len(stamped) - len(set(stamped)) <= 1
    assert not logged(fleet, "bug in lfield")


@pytest.mark.few(0)
def test_the_end_of_the_mission_is_not_unknown_while_a_majority_may_recover(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path), 1, options=FleetOptions(lost_after=3.0))
    run_until(fleet, "stamp 7\n", 30.0)
    lost = holder(fleet)
    fleet.crash(lost)
    run_until(fleet, "complete", 90.0)
    fleet.run(10.0)
    assert fleet.left == dict.fromkeys({"alpha", "bravo", "charlie"} - {lost}, exit_status.DONE)


def test_the_end_of_the_mission_is_unknown_without_a_majority(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path), 1, options=FleetOptions(lost_after=3.0))
    run_until(fleet, "stamp 7\n", 30.0)
    lost = holder(fleet)
    left, also_gone = sorted({"alpha", "bravo", "charlie"} - {lost})
    fleet.crash(lost)
    fleet.crash(also_gone)
    fleet.run(20.0)
    assert fleet.left == {left: exit_status.UNKNOWN_OUTCOME}


@pytest.mark.few(0)
def test_a_host_that_returns_too_late_does_not_continue(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path), 3)
    run_until(fleet, "stamp 10\n", 30.0)
    lost = holder(fleet)
    fleet.power_off(lost)
    run_until(fleet, "was recovered on", 20.0)
    fleet.boot(lost)
    run_until(fleet, "complete", 90.0)
    fleet.run(5.0)
    (row,) = (k for k in fleet.runs[lost].core.mobility.known_states() if k.generation == 1)
    assert (row.state, row.outcome) == ("EXITED", "superseded")
    assert len(logged(fleet, "complete")) == 1


@pytest.mark.few(0)
def test_a_host_that_returns_in_time_continues_itself(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path), 4)
    run_until(fleet, "stamp 10\n", 30.0)
    lost = holder(fleet)
    fleet.crash(lost)
    fleet.boot(lost)
    run_until(fleet, "resumed from the journal", 10.0)
    run_until(fleet, "complete", 90.0)
    assert not logged(fleet, "was recovered on")


def test_a_host_cut_off_stops_and_its_devices_are_safe_before_another_continues(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path, "climb"), 5)
    run_until(fleet, "climb 4\n", 60.0)
    cut, at = holder(fleet), fleet.now
    for other in {"alpha", "bravo", "charlie"} - {cut}:
        fleet.cut(cut, other)
    gone_on = run_until(fleet, "was recovered on", 20.0)
    lost = run_until(fleet, f"lease of {cut} ended", 1.0)
    assert at < lost <= at + LEASE * 1.01 + 0.1 < gone_on
    fleet.run(10.0)
    record = fleet.hardware[f"{cut[0]}.fc"].record
    assert not [command for command in record if command.what == "takeoff" and command.at > lost]
    assert any(command.at >= lost for command in record)
    fleet.heal_all()
    run_until(fleet, "complete", 200.0)


def test_without_a_majority_no_coordinator_acts_and_with_one_all_continue(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path), 6)
    run_until(fleet, "stamp 5\n", 30.0)
    names = ("alpha", "bravo", "charlie")
    for one in names:
        for other in names:
            if one < other:
                fleet.cut(one, other)
    fleet.run(LEASE * 1.01 + 0.4)
    before = len(logged(fleet, "stamp "))
    fleet.run(20.0)
    assert len(logged(fleet, "stamp ")) == before
    fleet.heal_all()
    run_until(fleet, "complete", 90.0)


@pytest.mark.few(0)
def test_a_coordinator_does_not_start_without_a_majority(tmp_path: Path) -> None:
    (tmp_path / "mission.devices.yaml").write_text("start: {without: [bravo]}\n")
    fleet = Fleet(mission(tmp_path), 7)
    for name in ("bravo", "charlie"):
        fleet.cut("alpha", name)
    fleet.run(20.0)
    assert logged(fleet, "walker not started: no majority of the members responds yet")
    assert not logged(fleet, "stamp ")
    fleet.heal("alpha", "charlie")
    run_until(fleet, "stamp 0", 10.0)


@pytest.mark.few(0)
def test_a_member_that_lost_its_promises_grants_no_lease_before_all_have_answered(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path), 11)
    run_until(fleet, "stamp 5\n", 30.0)
    other = "bravo" if holder(fleet) == "charlie" else "charlie"
    fleet.power_off("alpha")
    fleet.power_off(other)
    fleet.lose_disk(other)
    fleet.boot(other)
    fleet.run(20.0)
    stamped = len(logged(fleet, "stamp "))
    fleet.run(10.0)
    assert len(logged(fleet, "stamp ")) == stamped
    ((_, where, reason),) = logged(fleet, "is new or has lost a vote")
    assert (where, "and alpha must respond" in reason) == (other, True)
    fleet.boot("alpha")
    run_until(fleet, "complete", 120.0)


def test_after_a_permanent_loss_the_others_continue_with_new_members(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path), 13)
    run_until(fleet, "stamp 5\n", 30.0)
    holding = holder(fleet)
    other, lost = sorted({"alpha", "bravo", "charlie"} - {holding})
    fleet.lose(lost)
    fleet.power_off(other)
    fleet.lose_disk(other)
    fleet.boot(other)
    run_until(fleet, f"and {lost} must respond", 20.0)
    assert logged(fleet, "restart all hosts with a 'recovery: {members: [...]}' without it")
    fleet.run(20.0)
    assert not logged(fleet, "complete")
    # A host with the old members gets no link: the two cannot be in one majority.
    recovery = structs.replace(fleet.mission.bindings.recovery, members=(other, holding))
    fleet.mission = fleet.mission.with_bindings(structs.replace(fleet.mission.bindings, recovery=recovery))
    for name in (other, holding):
        fleet.stop(name)
    fleet.run(10.0)
    for name in (other, holding):
        fleet.boot(name)
    run_until(fleet, "complete", 120.0)


@pytest.mark.few(0)
def test_a_new_computer_with_the_name_of_a_member_counts_as_a_new_member(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path), 14)
    run_until(fleet, "stamp 5\n", 30.0)
    others = sorted({"alpha", "bravo", "charlie"} - {holder(fleet)})
    for name in others:
        fleet.power_off(name)
        fleet.lose_disk(name)
    fleet.boot(others[0])
    run_until(fleet, f"and {others[1]} must respond", 20.0)
    fleet.boot(others[1])
    run_until(fleet, "complete", 120.0)


def test_a_member_with_an_unreadable_promise_grants_no_lease_before_all_have_answered(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path), 12)
    run_until(fleet, "stamp 5\n", 30.0)
    lost = holder(fleet)
    fleet.power_off(lost)
    run_until(fleet, "was recovered on", 20.0)
    (one, other) = {"alpha", "bravo", "charlie"} - {lost}
    promised = one if other == holder(fleet) else other
    fleet.crash(promised)
    fleet.disks[promised].damage(RecordKey("fence", "walker"))
    # The successor is cut off, and the old holder has returned: it must not act.
    for name in (lost, promised):
        fleet.cut(holder(fleet), name)
    at = fleet.now
    fleet.boot(lost)
    fleet.boot(promised)
    fleet.run(30.0)
    assert logged(fleet, "is new or has lost a vote")
    assert not [line for line in logged(fleet, "stamp ") if line[0] > at + LEASE * 1.01]
    fleet.heal_all()
    run_until(fleet, "complete", 120.0)


@pytest.mark.few(0)
def test_a_coordinator_with_interval_zero_waits_for_its_host(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path, interval=-1.0), 8)
    run_until(fleet, "stamp 10\n", 30.0)
    lost = holder(fleet)
    fleet.power_off(lost)
    fleet.run(30.0)
    assert not logged(fleet, "was recovered on")
    fleet.boot(lost)
    run_until(fleet, "complete", 90.0)


def test_a_witness_is_a_member(tmp_path: Path) -> None:
    team = "//Post:a@alpha\n//Post:b@bravo\n//@charlie\n//Walker:walker@alpha\n"
    fleet = Fleet(mission(tmp_path, team=team), 9)
    run_until(fleet, "stamp 10\n", 30.0)
    lost = holder(fleet)
    fleet.power_off(lost)
    run_until(fleet, "complete", 90.0)
    assert logged(fleet, "was recovered on")


def test_without_journals_the_interval_is_ignored_and_logged(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path), 10, options=FleetOptions(keeps=False))
    run_until(fleet, "heartbeatInterval ignored: alpha has no journal", 5.0)
    run_until(fleet, "complete", 60.0)


def spoil(fleet: Fleet, host: str) -> CoordinatorCopy:
    """Damage the block of the walker on this host."""
    copy = fleet.runs[host].core.mobility.newest_copy("walker")
    assert copy is not None
    assert copy.block is not None
    copy.block = bytes(copy.block[: 8 * HEADER_WORDS]) + b"\xff" * (len(copy.block) - 8 * HEADER_WORDS)
    return copy


@pytest.mark.few(0)
def test_an_unreadable_checkpoint_is_reported_once_and_no_older_copy_continues(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path), 3)
    run_until(fleet, "stamp 10\n", 30.0)
    assert holder(fleet) == "bravo"
    fleet.power_off("bravo")
    copy, at = spoil(fleet, "alpha"), fleet.now
    fleet.run(40.0)
    (told,) = logged(fleet, "failover of walker impossible")
    assert told[1:] == (
        "alpha",
        "failover of walker impossible: its newest checkpoint, on alpha, cannot be read; if the host that "
        "held walker is permanently lost, 'lfield recover walker' resumes an older checkpoint, and "
        "'lfield forget walker' ends it\n",
    )
    assert copy.state_message().unreadable
    # alpha once, charlie twice: in between the host had promised alpha, which counted as a contact.
    assert len(logged(fleet, "walker suspected lost")) == 3
    assert len(logged(fleet, "failover of walker left to alpha")) == 2
    assert not logged(fleet, "was recovered on")
    assert not [line for line in logged(fleet, "stamp ") if line[0] > at]
    fleet.boot("bravo")
    run_until(fleet, "complete", 90.0)
    assert logged(fleet, "walker was recovered on bravo")

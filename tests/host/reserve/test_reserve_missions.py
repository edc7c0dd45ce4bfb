"""Reservations in missions: whole hosts in virtual time, cut links, hosts that crash and return."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from lfield.host.core import HostCore
from lfield.testing.mission.mission_team import MissionTeam
from lfield.wire.observer_messages import RecoverRequest

RESOURCE = """
resource Arm {
    init(string[] arg) { }
    portal work(real seconds) { sleep(seconds); }
    portal look() emit int { return 1; }
}
"""
HEAD = """
coordinator {0} {{
    init(string[] arg) {{
        Arm[] all = findArm();
        Arm a = findArm("a");
        Arm b = findArm("b");
        try {{
            {1}
        }} catch (ReservedException taken) {{
            print("taken " + taken.source() + ": " + taken.message());
        }} catch (ReservationLostException gone) {{
            print("lost " + gone.source() + ": " + gone.message());
        }} catch (UnreachableResourceException cut) {{
            print("cut " + cut.source() + ": " + cut.message());
        }}
        print("over");
    }}
}}
"""
#: Two arms, and two coordinators that start on the hosts of these arms.
TEAM = "//Arm:a@alpha\n//Arm:b@bravo\n//Pilot:pilot@alpha\n//Rover:rover@bravo\n"


@pytest.fixture
def open_team(tmp_path: Path, lfield_mission):  # type: ignore[no-untyped-def]
    """Make the team from the code of its two coordinators."""

    def made(pilot: str, rover: str, devices: str = "", **options: object) -> MissionTeam:
        program = RESOURCE + HEAD.format("Pilot", pilot) + HEAD.format("Rover", rover)
        (tmp_path / "arms.L").write_text(program)
        (tmp_path / "arms.dL").write_text(TEAM)
        if devices:
            (tmp_path / "arms.devices.yaml").write_text(devices)
        return lfield_mission(tmp_path / "arms.dL", **options)

    return made


def at(team: MissionTeam, words: str, who: str = "") -> float:
    """The time of the first line with this text."""
    return next(line.at for line in team.log if words in line.text and line.text.startswith(who))


def overlap(team: MissionTeam) -> list[tuple[str, str]]:
    """Overlapping calls of two coordinators at one arm."""
    calls = [call for call in team.calls if call.portal == "work"]
    return [
        (one.caller, other.caller)
        for one in calls
        for other in calls
        if one.resource == other.resource and one.caller < other.caller
        and one.at < (other.ended or team.now) and other.at < (one.ended or team.now)
    ]  # fmt: skip


TWICE = "reserve ({0}) {{ a.work(1.0); b.work(1.0); a.work(1.0); b.work(1.0); }}"


def test_two_coordinators_that_reserve_the_same_two_arms_take_turns(open_team):
    team = open_team(TWICE.format("all"), TWICE.format("all"), "reservations: {wait: 60}\n")
    team.run(until_done=True)
    assert team.ended == {"pilot": "done", "rover": "done"}
    assert len(team.calls) == 8
    assert overlap(team) == []
    assert not team.said("taken")
    callers = [call.caller for call in team.calls]
    assert callers == sorted(callers) or callers == sorted(callers)[::-1]


def test_nested_reservations_in_opposite_order_do_not_deadlock(open_team):
    nested = "reserve ({0}) {{ {0}.work(1.0); reserve ({1}) {{ {1}.work(1.0); {0}.work(1.0); }} }}"
    team = open_team(nested.format("a", "b"), nested.format("b", "a"), "reservations: {wait: 600}\n")
    team.run(until_done=True)
    assert team.ended == {"pilot": "done", "rover": "done"}
    assert team.now < 15.0
    assert overlap(team) == []
    assert team.said("taken") >= 1
    assert team.said("is reserved by") >= 1


def test_a_waiting_caller_is_denied_after_the_wait(open_team):
    team = open_team(
        "reserve (b) { b.work(12.0); b.work(12.0); }",
        'sleep(1.0); try { b.look(); } catch (ReservedException e) { print("no: " + e.message()); } '
        'within (1.0) { b.look(); }',
    )  # fmt: skip
    team.run(until=lambda: team.said("TimeLimit") or team.said("died"), at_most=60.0)
    denied_at = at(team, "no: b is reserved by pilot for ")
    assert denied_at == pytest.approx(6.0, abs=0.5)
    assert at(team, "TimeLimitException") == pytest.approx(denied_at + 1.0, abs=0.2)
    team.run(until=lambda: "pilot" in team.ended, at_most=60.0)
    assert team.ended["pilot"] == "done"
    assert not team.said("lost b:")


def test_a_call_longer_than_a_lease_keeps_the_reservation(open_team):
    """On this host, and on another host than the reserved one."""
    team = open_team(
        "reserve (all) { a.work(20.0); b.work(20.0); a.look(); b.look(); }",
        'sleep(19.0); for (int n = 0; n < 5; n = n + 1) { try { reserve (b) { b.look(); print("had it"); } } '
        'catch (ReservedException e) { print("no"); } }',
        "reservations: {lease: 2, wait: 3}\n",
    )
    team.run(until_done=True, at_most=200.0)
    assert not team.said("lost b:")
    assert team.said("no") >= 4
    granted = [call.at for call in team.calls if call.caller == "rover"]
    assert not granted or granted[0] > max(call.ended or 0.0 for call in team.calls if call.caller == "pilot")


def test_a_link_cut_for_less_than_a_lease_has_no_effect(open_team):
    team = open_team(
        "reserve (b) { b.look(); a.work(8.0); b.look(); }",
        "sleep(2.0); reserve (b) { b.look(); }",
        "reservations: {lease: 6, wait: 60}\n",
    )
    team.at(1.5, lambda: team.cut("alpha", "bravo"))
    team.at(4.0, lambda: team.heal("alpha", "bravo"))
    team.run(until_done=True, at_most=100.0)
    assert not team.said("lost b:")
    callers = [call.caller for call in team.calls if call.resource == "b"]
    assert callers == ["pilot", "pilot", "rover"]


def test_a_holder_cut_off_for_longer_loses_the_reservation_before_its_next_portal(open_team):
    team = open_team(
        "reserve (b) { b.look(); a.work(20.0); b.work(1.0); }",
        "sleep(2.0); reserve (b) { b.work(30.0); }",
        "reservations: {lease: 6, wait: 60}\n",
    )
    team.at(1.5, lambda: team.cut("alpha", "bravo"))
    team.at(15.0, lambda: team.heal("alpha", "bravo"))
    team.run(until_done=True, at_most=100.0)
    calls = [(call.caller, call.portal) for call in team.calls if call.resource == "b"]
    assert calls == [("pilot", "look"), ("rover", "work")]
    started = next(call.at for call in team.calls if call.caller == "rover")
    assert 6.0 < started < 8.5
    assert team.said("lost b: b was reserved by rover ") == 1
    assert team.ended == {"pilot": "done", "rover": "done"}


def test_a_reservation_survives_a_restart_of_its_host(open_team):
    team = open_team(
        "reserve (b) { b.look(); a.work(6.0); "
        'try { b.look(); } catch (RestartException e) { print("told"); }'
        " b.work(1.0); a.work(4.0); b.work(1.0); }",
        "sleep(20.0);",
        "reservations: {lease: 6, wait: 60}\n",
    )
    team.at(2.0, lambda: team.crash("bravo"))
    team.at(3.0, lambda: team.boot("bravo"))
    team.run(until=lambda: "pilot" in team.ended, at_most=100.0)
    assert team.ended["pilot"] == "done"
    assert not team.said("lost b:")
    assert team.said("pilot: told") == 1


@pytest.mark.parametrize(("seconds_off", "lost"), [(1.0, 0), (9.0, 1)])
def test_a_coordinator_that_continues_after_a_restart_keeps_an_unexpired_reservation(
    open_team, seconds_off: float, lost: int
):
    """The host of the coordinator restarts; the reserved resource is on the other host."""
    team = open_team(
        "reserve (b) { b.work(0.5); try { a.work(6.0); } catch (RestartException e) { } b.work(0.5); }",
        "sleep(1000.0);",
        "reservations: {lease: 6, wait: 60}\n",
    )
    team.run(2.0)
    team.crash("alpha")
    team.run(seconds_off)
    held = team._fleet.runs["bravo"].core.reservations.held
    assert [each.resource for each in held] == ["b"][lost:]
    team.boot("alpha")
    team.run(until=lambda: "pilot" in team.ended, at_most=100.0)
    assert team.said("pilot resumed from the journal") == 1
    assert team.ended["pilot"] == "done"
    assert team.said("lost b: ") == lost
    assert len([call for call in team.calls if call.resource == "b"]) == 2 - lost


def test_after_a_restart_the_reservation_lasts_for_its_lease(open_team):
    """The holder is cut off, so no host renews the restored record."""
    team = open_team(
        "reserve (b) { b.look(); a.work(60.0); }",
        "sleep(30.0);",
        "reservations: {lease: 6, wait: 60}\n",
    )
    team.run(2.0)
    team.cut("alpha", "bravo")
    team.crash("bravo")
    team.run(1.0)
    team.boot("bravo")
    booted = team.now
    held = team._fleet.runs["bravo"].core.reservations
    team.run(5.0)
    assert [(each.resource, each.holder) for each in held.held] == [("b", ("pilot", 1))]
    team.run(booted + 7.0 - team.now)
    assert held.held == []


def test_a_reservation_ends_with_its_coordinator(open_team):
    team = open_team(
        "reserve (all) { a.look(); int[] none = new int[0]; print(i2s(none[1])); }",
        "sleep(1.0); reserve (all) { a.work(1.0); b.work(1.0); }",
        "reservations: {lease: 600, wait: 30}\n",
    )
    team.run(until=lambda: "rover" in team.ended, at_most=100.0)
    assert team.ended == {"pilot": "died", "rover": "done"}
    assert at(team, "over", "rover") < 5.0


def test_the_reservation_of_a_crashed_host_ends_with_its_lease(open_team):
    team = open_team(
        "reserve (b) { b.look(); a.work(60.0); }",
        "sleep(2.0); reserve (b) { b.look(); }",
        "reservations: {lease: 4, wait: 30}\n",
    )
    team.run(3.0)
    team.crash("alpha")
    team.run(until=lambda: "rover" in team.ended, at_most=60.0)
    started = next(call.at for call in team.calls if call.caller == "rover")
    assert 6.0 < started < 8.5


def at_host(team: MissionTeam, host: str, action: Callable[[HostCore], object]) -> None:
    """An action of an operator at a host."""
    life = team._fleet.runs[host]

    def act() -> None:
        action(life.core)
        life.host.step()

    life.process.loop.enter(act)


def test_a_forgotten_coordinator_loses_its_reservation(open_team):
    team = open_team(
        "reserve (b) { b.look(); a.work(60.0); }",
        "sleep(2.0); reserve (b) { b.look(); }",
        "reservations: {lease: 600, wait: 600}\n",
    )
    team.run(5.0)
    team.power_off("alpha")
    team.run(5.0)
    assert "rover" not in team.ended
    at_host(team, "bravo", lambda core: core.forget("pilot"))
    team.run(0.5)
    assert team.ended["rover"] == "done"


def test_a_recovered_coordinator_has_lost_its_reservation(open_team):
    """The coordinator continues at its last call on bravo, in the block: that call reports the loss."""
    team = open_team(
        "reserve (b) { b.work(0.5); a.work(60.0); b.look(); }",
        "sleep(600.0);",
        "reservations: {lease: 600, wait: 600}\n",
    )
    team.run(until=lambda: any(call.resource == "a" for call in team.calls), at_most=20.0)
    team.run(1.0)
    team.power_off("alpha")
    team.run(1.0)
    row = next(row for row in team._fleet.runs["bravo"].core.mobility.known_states() if row.agent == "pilot")
    at_host(team, "bravo", lambda core: core.recover(RecoverRequest("pilot", 1, row.sequence, 1)))
    team.run(15.0)
    assert team.said("pilot recovered on this host as start ") == 1
    assert [held.resource for held in team._fleet.runs["bravo"].core.reservations.held] == []
    assert [call.portal for call in team.calls if call.resource == "b"] == ["work"]


FINDERS = """
coordinator Pilot {
    init(string[] arg) {
        Lift[] all = findLift();
        reserve (all[0]) {
            all[0].lift(0.0);
            Lift[] still = findLift();
            print("the holder finds " + i2s(still.length()));
            sleep(12.0);
            all[0].lift(0.0);
        }
    }
}
coordinator Rover {
    init(string[] arg) {
        sleep(5.0);
        Lift[] others = findLift();
        print("others find " + i2s(others.length()) + ": " + others[0].agent());
        print("why: " + explainLift());
        sleep(15.0);
        others = findLift();
        print("then " + i2s(others.length()));
    }
}
"""
CRANES = """
resource Arm {
    init(string[] arg) { }
    portal hoist(real height) emit real { return height; }
}
"""
CAN_LIFT = """
registry: 1
providers:
  Arm: {serves: {Lift: {portals: {lift: hoist, lower: hoist}}}}
"""


def test_a_reserved_resource_is_offered_only_to_its_holder(tmp_path, lfield_mission):
    (tmp_path / "arms.L").write_text(CRANES + FINDERS)
    (tmp_path / "arms.dL").write_text(TEAM)
    (tmp_path / "arms.capabilities.yaml").write_text(CAN_LIFT)
    team = lfield_mission(tmp_path / "arms.dL")
    team.run(until_done=True, at_most=100.0)
    assert team.said("the holder finds 2") == 1
    reserved = next(call.resource for call in team.calls)
    assert team.said(f"others find 1: {'ba'[reserved == 'b']}") == 1
    assert team.said("why: there is 1 offer, by 1 agent") == 1
    assert team.said(f"{reserved}: reserved by pilot for ") == 1
    assert team.said("then 2") == 1


ASKED = """
resource Arm {
    real raised;
    init(string[] arg) { }
    portal hoist(real height) emit real { raised = height; return height; }
    portal level() emit real { sleep(0.9); return raised; }
}
coordinator Pilot {
    init(string[] arg) {
        sleep(4.0);
        Lift[] all = findLift("raised >= 0.0");
        reserve (all[0]) {
            reserve (all[1]) {
                all[0].lift(3.0);
                sleep(15.0);
                Lift[] still = findLift("raised == 3.0");
                print("it has risen: " + i2s(still.length()));
                if (still[0].age("raised") < 3.0) print("and that lately");
            }
        }
    }
}
coordinator Rover { init(string[] arg) { } }
"""
ASKED_OF = """
registry: 1
attributes: {raised: {type: real, live: true, max_age: 4.0}}
providers:
  Arm:
    live: {raised: level()}
    serves: {Lift: {portals: {lift: hoist, lower: hoist}}}
"""


def test_attribute_queries_of_a_host_do_not_block_reservations(tmp_path, lfield_mission):
    """The queries run nearly all the time; a reservation does not wait for them, and they continue."""
    (tmp_path / "arms.L").write_text(ASKED)
    (tmp_path / "arms.dL").write_text(TEAM)
    (tmp_path / "arms.capabilities.yaml").write_text(ASKED_OF)
    (tmp_path / "arms.devices.yaml").write_text("reservations: {wait: 0}\n")
    team = lfield_mission(tmp_path / "arms.dL")
    team.run(until_done=True, at_most=60.0)
    assert team.ended["pilot"] == "done"
    assert team.said("it has risen: 1") == 1
    assert team.said("and that lately") == 1


def test_a_coordinator_recovered_in_a_block_is_informed_of_the_resource(open_team):
    team = open_team(
        "reserve (b) { b.look(); b.work(60.0); }", "sleep(600.0);", "reservations: {lease: 600}\n"
    )
    team.run(3.0)
    team.power_off("bravo")
    team.run(1.0)
    row = next(row for row in team._fleet.runs["alpha"].core.mobility.known_states() if row.agent == "pilot")
    at_host(team, "alpha", lambda core: core.recover(RecoverRequest("pilot", 1, row.sequence, 1)))
    team.run(5.0)
    assert team.said(" (b)") >= 1
    assert team.said("(b.)") == 0

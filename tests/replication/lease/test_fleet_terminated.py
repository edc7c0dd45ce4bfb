"""A coordinator that has terminated under leases is never recovered. Whole hosts, virtual time."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.simulate.host_fleet import Fleet, FleetOptions
from lfield.wire.observer_messages import RecoverRequest
from simulation_testing.invariants.breaches import Breaches
from simulation_testing.invariants.end_checks import EndChecks

PROGRAM = """
resource Valve {
    int turns;
    init(string[] arg) { }
    portal turn() emit int { turns += 1; sleep(1.0); return turns; }
}
coordinator Boss {
    init(string[] arg) {
        heartbeatInterval(INTERVAL);
        while (true) {
            try {
                print("turned " + i2s(findValve("v").turn()));
                END
            }
            catch (RestartException e) { print("once more"); }
            catch (UnreachableResourceException e) { sleep(1.0); }
        }
    }
}
"""
TEAM = "//Boss:boss@a\n//Valve:v@b\n//@c\n"
#: The two kinds of termination: `init` returns, or an exception is not caught.
ENDS = {"done": "return;", "died": "throw new Exception();"}


def mission(folder: Path, end: str = "done", team: str = TEAM, interval: float = 3.0) -> Mission:
    program = PROGRAM.replace("END", ENDS[end]).replace("INTERVAL", str(interval))
    (folder / "mission.L").write_text(program)
    (folder / "mission.dL").write_text(team)
    return load_mission(folder / "mission.dL", simulate=True)


def log_lines(fleet: Fleet, what: str) -> list[tuple[float, str, str]]:
    return [line for line in fleet.log if what in line[2]]


def judged(mission: Mission, seed: int = 1, lost_after: float | None = None) -> tuple[Fleet, Breaches]:
    """A fleet, and the violations that the judge of terminations finds in it."""
    fleet: Fleet

    def newest_start(agent: str, below: int) -> int:
        rows = (row for life in fleet.runs.values() for row in life.core.mobility.known_states())
        return max((row.generation for row in rows if row.generation < below), default=0)

    breaches = Breaches(lambda: fleet.now)
    judge = EndChecks(breaches, lambda: fleet, newest_start)
    fleet = Fleet(
        mission,
        seed,
        on_start=lambda name, life: judge.on_host_start(life),
        options=FleetOptions(lost_after=lost_after),
    )
    return fleet, breaches


def states(fleet: Fleet) -> dict[str, list[tuple[int, str, str]]]:
    """The start, state and outcome of boss on each running host."""
    return {
        name: [(row.generation, row.state, row.outcome) for row in life.core.mobility.known_states()]
        for name, life in fleet.runs.items()
    }


def run_until_ended(fleet: Fleet, host: str = "b") -> None:
    for _ in range(60):
        if states(fleet)[host] == [(1, "EXITED", "done")]:
            return
        fleet.run(0.05)
    raise AssertionError(f"boss has not ended: {states(fleet)}")


@pytest.mark.parametrize("end", ENDS)
def test_a_coordinator_whose_end_a_third_host_knows_is_not_recovered(tmp_path: Path, end: str) -> None:
    fleet, breaches = judged(mission(tmp_path, end))
    fleet.run(0.8)
    fleet.cut("a", "b")
    fleet.run(8.2)
    fleet.heal_all()
    fleet.run(20.0)
    assert not breaches
    assert [where for _, where, _ in log_lines(fleet, "turned 1")] == ["b"]
    assert not log_lines(fleet, "recovered")
    assert not log_lines(fleet, "turned 2")
    for life in fleet.runs.values():
        (row,) = life.core.mobility.known_states()
        assert (row.agent, row.state, row.outcome, row.where) == ("boss", "EXITED", end, "b")


def test_gossip_brings_an_end_to_a_host_without_a_link_to_the_source(tmp_path: Path) -> None:
    fleet, _ = judged(mission(tmp_path))
    fleet.run(0.8)
    fleet.cut("a", "b")
    run_until_ended(fleet)
    fleet.run(1.0)
    assert states(fleet) == {key: [(1, "EXITED", "done")] for key in "abc"}


@pytest.mark.parametrize("again", ["crash", "power_off"])
def test_a_known_end_is_still_known_after_a_restart(tmp_path: Path, again: str) -> None:
    fleet, breaches = judged(mission(tmp_path))
    fleet.run(0.8)
    for other in "bc":
        fleet.cut("a", other)
    run_until_ended(fleet)
    run_until_ended(fleet, "c")
    fleet.power_off("b")
    getattr(fleet, again)("c")
    fleet.boot("c")
    fleet.heal("a", "c")
    fleet.run(30.0)
    assert not breaches
    assert not log_lines(fleet, "recovered")
    assert states(fleet) == {key: [(1, "EXITED", "done")] for key in "ac"}


def test_a_member_with_a_new_disk_learns_the_end_before_it_promises(tmp_path: Path) -> None:
    fleet, breaches = judged(mission(tmp_path))
    fleet.run(0.8)
    for other in "bc":
        fleet.cut("a", other)
    run_until_ended(fleet)
    run_until_ended(fleet, "c")
    fleet.power_off("b")
    fleet.power_off("c")
    fleet.lose_disk("c")
    fleet.boot("c")
    fleet.heal("a", "c")
    fleet.run(20.0)
    assert not log_lines(fleet, "recovered")
    fleet.heal_all()
    fleet.run(0.1)
    fleet.run(20.0)
    assert not breaches
    assert not log_lines(fleet, "recovered")
    assert states(fleet) == {key: [(1, "EXITED", "done")] for key in "abc"}


@pytest.mark.parametrize("greets", [False, True], ids=["linked", "relinked"])
def test_an_end_is_sent_to_others_only_when_it_is_durable_at_its_host(
    tmp_path: Path, *, greets: bool
) -> None:
    """Other hosts might store the end as final, although boss would continue after a crash of b."""
    fleet, breaches = judged(mission(tmp_path))
    fleet.run(0.9)
    fleet.disks["b"].sync = 60.0
    run_until_ended(fleet)
    if greets:
        fleet.network.reset("b", "c")
    fleet.run(1.5)
    assert "EXITED" not in {state for name in "ac" for _, state, _ in states(fleet)[name]}
    fleet.power_off("b")
    fleet.disks["b"].sync = 0.002
    fleet.boot("b")
    fleet.run(20.0)
    assert not breaches
    assert len(log_lines(fleet, "turned 1")) == 2
    assert states(fleet) == {key: [(1, "EXITED", "done")] for key in "abc"}


def test_an_end_known_only_by_its_host_is_not_final(tmp_path: Path) -> None:
    """The host with the end is isolated: it has no lease, and the other hosts continue."""
    fleet, breaches = judged(mission(tmp_path))
    fleet.run(0.8)
    for other in "ac":
        fleet.cut("b", other)
    fleet.run(10.0)
    assert log_lines(fleet, "boss recovered on this host")
    fleet.heal_all()
    fleet.run(20.0)
    assert not breaches
    assert log_lines(fleet, "turned 2")
    for rows in states(fleet).values():
        assert {outcome for generation, _, outcome in rows if generation > 1} == {"done"}


def cut_off_at_the_end(folder: Path, *, until_done: bool = True) -> tuple[Fleet, Breaches]:
    """Let boss end on b, which is isolated; other hosts would recover it after ten seconds."""
    slow = mission(folder, interval=10.0)
    fleet, breaches = judged(slow, lost_after=5.0 if until_done else None)
    fleet.run(0.9)
    for other in "ac":
        fleet.cut("b", other)
    return fleet, breaches


def test_with_until_done_a_host_waits_until_the_end_is_final(tmp_path: Path) -> None:
    fleet, breaches = cut_off_at_the_end(tmp_path)
    fleet.run(5.0)
    assert log_lines(
        fleet, "end of boss not final: no majority of the members has stored it; b waits for this majority"
    )
    assert "b" in fleet.runs
    fleet.heal_all()
    fleet.run(20.0)
    assert not breaches
    assert fleet.left == dict.fromkeys("abc", 0)
    assert not log_lines(fleet, "recovered")


def test_with_until_done_a_host_without_a_majority_waits_for_a_limited_time(tmp_path: Path) -> None:
    fleet, _ = cut_off_at_the_end(tmp_path)
    fleet.run(9.0)
    assert fleet.left["b"] == 0
    assert log_lines(fleet, "no majority of the members responded for 5 s; another host may resume")


def test_an_operator_cannot_recover_an_ended_coordinator(tmp_path: Path) -> None:
    fleet, breaches = judged(mission(tmp_path))
    fleet.run(0.8)
    fleet.cut("a", "b")
    row = fleet.runs["a"].core.mobility.recoverable_state("boss")
    assert row is not None
    request = RecoverRequest("boss", row.generation, row.sequence, row.generation)
    run_until_ended(fleet)
    fleet.run(1.0)
    answer = fleet.runs["a"].core.recover(request)
    assert (answer.generation, "boss has ended on b (done)" in answer.reason) == (0, True)
    assert not breaches


def test_an_operator_cannot_recover_under_leases_without_a_majority(tmp_path: Path) -> None:
    fleet, _ = judged(mission(tmp_path))
    fleet.run(0.8)
    for other in "bc":
        fleet.cut("a", other)
    row = fleet.runs["a"].core.mobility.recoverable_state("boss")
    assert row is not None
    fleet.run(3.0)
    request = RecoverRequest("boss", row.generation, row.sequence, row.generation)
    answer = fleet.runs["a"].core.recover(request)
    assert (answer.generation, "no majority of the members responds to a" in answer.reason) == (0, True)


def test_a_new_run_of_the_mission_starts_ended_coordinators_again(tmp_path: Path) -> None:
    fleet, breaches = judged(mission(tmp_path))
    fleet.run(6.0)
    assert states(fleet) == {key: [(1, "EXITED", "done")] for key in "abc"}
    for name in "abc":
        fleet.stop(name)
    fleet.run(10.0)
    for name in "abc":
        fleet.boot(name)
    fleet.run(10.0)
    assert len(log_lines(fleet, "turned 1")) == 2
    assert not breaches
    assert states(fleet) == {key: [(1, "EXITED", "done"), (2, "EXITED", "done")] for key in "abc"}


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(3, 27))
def test_a_final_end_stays_final_under_random_cuts(tmp_path: Path, seed: int) -> None:
    """Random cuts around the end of boss, in teams of three to five; every start ends once."""
    rng = random.Random(seed)
    team = TEAM + "".join(f"//@{name}\n" for name in "de"[: rng.randrange(3)])
    fleet, breaches = judged(mission(tmp_path, team=team), seed)
    names = sorted(fleet.runs)
    fleet.run(rng.uniform(0.3, 1.6))
    for _ in range(6):
        one, other = rng.sample(names, 2)
        fleet.cut(one, other)
        if rng.random() < 0.5:
            fleet.heal(*rng.sample(names, 2))
        fleet.run(rng.uniform(0.1, 4.0))
    fleet.heal_all()
    fleet.run(40.0)
    assert not breaches
    for rows in states(fleet).values():
        assert all(state == "EXITED" for _, state, _ in rows)
        assert max(rows)[2] == "done"

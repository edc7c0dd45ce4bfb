"""A new start waits for the hosts that a mission needs, and names them. Whole hosts, in virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from lfield.host.inputs import HostInput, PauseOrdered, StartOrdered, StopOrdered
from lfield.journal.records import StartCounter
from lfield.mission.access.signed_bundle import BundleId
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.simulate.host_fleet import Fleet, FleetOptions
from lfield.wire.observer_messages import Status

PROGRAM = """
resource Post {
    int count;
    init(string[] arg) { }
    portal work(real seconds) emit int {
        count = count + 1;
        write("works\\n");
        sleep(seconds);
        return count;
    }
}
coordinator Boss {
    init(string[] arg) {
        print("begins");
        for (Post post : findPost()) {
            try { post.work(s2f(arg[1])); }
            catch (RestartException e) { print("restarted"); }
            catch (UnreachableResourceException e) { print("unreachable"); }
        }
        print("ends");
    }
}
"""
TEAM = "//Boss:boss@alpha?{0}\n//Post:one@alpha\n//Post:two@bravo\n//Post:three@carol\n//@dora\n"


def mission(
    folder: Path, without: str = "", seconds: float = 0.1, team: str = TEAM, text: str = PROGRAM
) -> Mission:
    (folder / "mission.L").write_text(text)
    (folder / "mission.dL").write_text(team.format(seconds))
    if without:
        (folder / "mission.devices.yaml").write_text(f"start: {{without: [{without}]}}\n")
    return load_mission(folder / "mission.dL", simulate=True)


@pytest.fixture
def fleets() -> Iterator[list[Fleet]]:
    made: list[Fleet] = []
    yield made
    for fleet in made:
        fleet.close()


def count_logged(fleet: Fleet, text: str, host: str = "") -> int:
    return sum(text in line and host in ("", name) for _, name, line in fleet.log)


def status(fleet: Fleet, host: str) -> Status:
    return fleet.runs[host].host.status()


def started(fleet: Fleet) -> bool:
    return count_logged(fleet, "boss: begins") > 0


def event(fleet: Fleet, entry: HostInput) -> None:
    """Feed an input to alpha, in its own process."""
    life = fleet.runs["alpha"]
    life.process.loop.enter(lambda: life.host.dispatch(entry))


def alone(made: Mission, *absent: str, keeps: bool = True) -> Fleet:
    """A fleet of which some hosts have not started yet."""
    fleet = Fleet(made, 1, options=FleetOptions(keeps=keeps))
    for name in absent:
        fleet.power_off(name)
    return fleet


@pytest.mark.parametrize("keeps", [True, False])
def test_a_new_start_waits_for_every_host_with_resources_and_for_no_other(
    tmp_path: Path, keeps: bool
) -> None:
    fleet = alone(mission(tmp_path), "carol", "dora", keeps=keeps)
    fleet.run(60.0)
    assert not started(fleet)
    start = status(fleet, "alpha").start
    assert start is not None
    assert (start.agents, start.hosts, start.held) == (["boss"], ["carol"], "")
    assert status(fleet, "bravo").start is None
    fleet.boot("carol")
    fleet.run(3.0)
    assert started(fleet)
    assert status(fleet, "alpha").start is None
    assert count_logged(fleet, "boss: begins") == 1


def test_without_a_record_a_witness_must_answer_unless_it_is_left_out(tmp_path: Path) -> None:
    loaded = mission(tmp_path, "dora")
    fleet = Fleet(loaded, 1, options=FleetOptions(keeps=False))
    fleet.power_off("dora")
    for name in ("alpha", "bravo", "carol"):
        fleet.crash(name)
        fleet.boot(name)
    fleet.run(10.0)
    assert started(fleet)
    warning = "boss started without proof: this host has no record of earlier starts, and dora did not answer"
    assert count_logged(fleet, warning, "alpha") == 1


def test_a_host_left_out_by_the_devices_file_may_start_later(tmp_path: Path) -> None:
    fleet = alone(mission(tmp_path, "carol", seconds=4.0), "carol")
    fleet.run(5.0)
    assert started(fleet)
    fleet.boot("carol")
    fleet.run(20.0)
    assert count_logged(fleet, "works", "carol") == 1
    assert count_logged(fleet, "boss: ends") == 1


def test_a_command_starts_without_a_host_and_refuses_an_unknown_one(tmp_path: Path) -> None:
    fleet = alone(mission(tmp_path), "carol")
    fleet.run(5.0)
    core = fleet.runs["alpha"].core
    answer = core.startup.start(["karol"])
    assert answer.trouble == "the deployment has no host 'karol': did you mean 'carol'?"
    assert (answer.started, answer.waiting and answer.waiting.hosts) == ([], ["carol"])
    assert core.startup.start([]).waiting == answer.waiting
    fleet.run(1.0)
    assert not started(fleet)
    answer = core.startup.start(["carol"])
    assert (answer.started, answer.waiting, answer.trouble) == (["boss"], None, "")
    fleet.run(1.0)
    assert started(fleet)
    # A repeated command gets the answer that nothing waits.
    assert core.startup.start(["carol"]) == core.startup.start([])


def test_a_host_lost_before_the_start_is_waited_for_again(tmp_path: Path) -> None:
    fleet = alone(mission(tmp_path), "carol")
    fleet.run(5.0)
    fleet.cut("alpha", "bravo")
    fleet.boot("carol")
    fleet.run(10.0)
    assert not started(fleet)
    assert count_logged(fleet, "bravo (its link was lost", "alpha")
    fleet.heal_all()
    fleet.run(5.0)
    assert started(fleet)


@pytest.mark.few(0)
def test_missing_hosts_are_logged_at_once_and_then_less_often(tmp_path: Path) -> None:
    fleet = alone(mission(tmp_path), "carol")
    fleet.run(3.0)
    line = "boss not started: waiting for carol (no link yet)"
    assert count_logged(fleet, line, "alpha") == 1
    fleet.run(1200.0)
    times = [at for at, _, text in fleet.log if line in text]
    gaps = [later - at for at, later in pairwise(times)]
    assert gaps[0] == pytest.approx(10.0, rel=0.1)
    assert gaps[-1] == pytest.approx(300.0, rel=0.1)
    assert len(times) < 12


def other_bundle(fleet: Fleet, host: str, made: Mission) -> None:
    """Start a host again from other files."""
    fleet.crash(host)
    before, fleet.mission = fleet.mission, replace(fleet.mission, release=made.release, program=made.program)
    fleet.boot(host)
    fleet.run(0.01)
    fleet.mission = before


def test_a_host_with_another_bundle_prevents_the_start_and_both_report_it(tmp_path: Path) -> None:
    own_id, other_id = b"\x11" * 32, b"\x22" * 32
    changed = replace(mission(tmp_path), release=BundleId(own_id))
    fleet = alone(changed, "carol")
    fleet.boot("carol")
    other_bundle(fleet, "carol", replace(changed, release=BundleId(other_id)))
    fleet.run(15.0)
    assert not started(fleet)
    text = "alpha runs bundle 1111111111111111 and carol runs bundle 2222222222222222"
    (refused,) = (one for one in status(fleet, "alpha").refused if one.host == "carol")
    assert (refused.bundle, text in refused.reason or "carol runs" in refused.reason) == (other_id, True)
    assert {one.bundle for one in status(fleet, "carol").refused} == {own_id}
    assert {one.host for one in status(fleet, "carol").refused} == {"alpha", "bravo", "dora"}
    assert count_logged(fleet, "boss not started: waiting for carol (refused: ", "alpha")
    assert count_logged(fleet, "runs bundle 2222222222222222", "alpha")
    # After a copy of the right bundle the host joins.
    fleet.crash("carol")
    fleet.boot("carol")
    fleet.run(5.0)
    assert started(fleet)
    assert status(fleet, "alpha").refused == []


def test_a_coordinator_restored_from_the_journal_does_not_wait(tmp_path: Path) -> None:
    for ends in ("crash", "stop"):
        fleet = Fleet(mission(tmp_path, seconds=8.0), 1)
        fleet.run(4.0)
        assert started(fleet)
        (fleet.crash if ends == "crash" else fleet.stop)("alpha")
        fleet.run(2.0)
        for name in ("bravo", "carol", "dora"):
            fleet.power_off(name)
        fleet.boot("alpha")
        fleet.run(5.0)
        assert count_logged(fleet, "boss: restarted", "alpha") == 1
        assert not count_logged(fleet, "not started: ")
        fleet.close()


def test_a_crash_during_the_wait_leaves_a_start_that_waits(tmp_path: Path) -> None:
    fleet = alone(mission(tmp_path), "carol")
    fleet.run(5.0)
    fleet.crash("alpha")
    fleet.boot("alpha")
    fleet.run(20.0)
    assert not started(fleet)
    assert not any(isinstance(page, StartCounter) and page.count for page in fleet.disks["alpha"].records())
    fleet.boot("carol")
    fleet.run(3.0)
    assert started(fleet)


def test_a_stop_of_the_host_ends_the_wait(tmp_path: Path) -> None:
    fleet = alone(mission(tmp_path), "carol")
    fleet.run(5.0)
    fleet.stop("alpha")
    fleet.run(5.0)
    assert "alpha" not in fleet.runs
    fleet.boot("carol")
    fleet.run(5.0)
    assert not started(fleet)


def test_a_pause_during_the_wait_holds_the_start_until_the_resume(tmp_path: Path) -> None:
    fleet = alone(mission(tmp_path), "carol")
    fleet.run(5.0)
    event(fleet, PauseOrdered(True))
    fleet.boot("carol")
    fleet.run(5.0)
    assert not started(fleet)
    event(fleet, PauseOrdered(False))
    fleet.run(1.0)
    assert started(fleet)


def test_an_emergency_stop_during_the_wait_holds_the_start_until_a_command(tmp_path: Path) -> None:
    fleet = alone(mission(tmp_path), "carol")
    fleet.run(5.0)
    event(fleet, StopOrdered("a person on the field"))
    fleet.boot("carol")
    fleet.run(5.0)
    assert not started(fleet)
    # The lift starts no coordinator.
    event(fleet, StopOrdered(""))
    fleet.run(20.0)
    start = status(fleet, "alpha").start
    assert start is not None
    assert "emergency stop" in start.held
    assert not started(fleet)
    event(fleet, StartOrdered([]))
    fleet.run(1.0)
    assert started(fleet)


def test_in_an_overlay_the_start_needs_all_hosts_not_only_neighbours(tmp_path: Path) -> None:
    names = [f"h{number:02}" for number in range(14)]
    team = "//Boss:boss@h00?{0}\n" + "".join(f"//Post:p{name}@{name}\n" for name in names)
    loaded = mission(tmp_path, team=team)
    fleet = Fleet(loaded, 1)
    near = fleet.runs["h00"].core.membership.neighbours
    far = next(name for name in names[1:] if name not in near)
    fleet.power_off(far)
    fleet.run(30.0)
    assert not started(fleet)
    start = status(fleet, "h00").start
    assert start is not None
    assert start.hosts == [far]
    fleet.boot(far)
    fleet.run(5.0)
    assert started(fleet)


def test_until_done_waits_as_long_as_the_start_does(tmp_path: Path) -> None:
    fleet = Fleet(mission(tmp_path), 1, options=FleetOptions(lost_after=3.0))
    fleet.power_off("carol")
    fleet.run(60.0)
    assert {"alpha", "bravo"} <= fleet.runs.keys()
    fleet.boot("carol")
    fleet.run(20.0)
    assert fleet.left == dict.fromkeys(fleet.mission.team.hosts, 0)


def test_a_start_that_waits_for_hosts_and_a_lease_uses_no_processor_time(tmp_path: Path) -> None:
    """Due log lines are not evaluated repeatedly while the start waits for something else."""
    text = PROGRAM.replace('print("begins");', 'heartbeatInterval(3.0); print("begins");')
    loaded = mission(tmp_path, text=text)
    fleet = Fleet(loaded, 1)
    for name in ("bravo", "carol", "dora"):
        fleet.power_off(name)
    fleet.run(5.0)
    core = fleet.runs["alpha"].core
    runs, run = [0], core.run

    def counted() -> float | None:
        runs[0] += 1
        return run()

    core.run = counted  # type: ignore[method-assign]
    fleet.boot("dora")
    fleet.boot("bravo")
    fleet.run(30.0)
    fleet.power_off("dora")
    fleet.power_off("bravo")
    fleet.run(60.0)
    assert not started(fleet)
    assert runs[0] < 90.0 * 60

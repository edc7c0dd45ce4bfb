"""Limits of a wait for another coordinator, rights to start it, and the effect of its end on the mission."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from lfield import exit_status
from lfield.errors import ProgramError
from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet, FleetOptions

PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal work(real seconds) { sleep(seconds); }
    portal home() { print("home"); }
}
coordinator Patrol {
    init(string[] arg) {
        //interval
        Post post = findPost(arg[1]);
        try {
            for (int i = 0; i < s2i(arg[2]); i += 1) {
                try { post.work(1.0); }
                catch (UnreachableResourceException e) { sleep(1.0); }
                catch (RestartException e) { post = findPost(arg[1]); }
            }
        }
        finally { post.home(); }
    }
}
coordinator Boss {
    init(string[] arg) {
        //boss
    }
}
"""
DEPLOYMENT = "//Post:p1@alpha\n//Post:p2@carol\n//Boss:boss@alpha\nstartable Patrol:patrol@bravo?p1&3\n"
TRY = """
        try { {what} print("went on"); }
        catch (TimeLimitException e) { print("limit: " + e.message()); }
        catch (AccessException e) { print("access: " + e.message()); }
        catch (ReservedException e) { print("runs: " + e.message()); }
"""


@pytest.fixture
def team(tmp_path: Path) -> Callable[..., Fleet]:
    def make(
        boss: str, access: str = "", interval: str = "", deployment: str = DEPLOYMENT, **options: float
    ) -> Fleet:
        text = PROGRAM.replace("//boss", boss).replace("//interval", interval)
        (tmp_path / "mission.L").write_text(text)
        (tmp_path / "mission.dL").write_text(deployment)
        if access:
            (tmp_path / "mission.access.yaml").write_text(access)
        return Fleet(load_mission(tmp_path / "mission.dL"), 1, options=FleetOptions(**options))  # type: ignore[arg-type]  # of a test

    return make


def attempt(what: str) -> str:
    return TRY.replace("{what}", what)


def count_logged(fleet: Fleet, text: str) -> int:
    return sum(text in line for _, _, line in fleet.log)


def when(fleet: Fleet, text: str) -> float:
    return next(at for at, _, line in fleet.log if text in line)


@pytest.mark.parametrize("what", ['start("patrol", 4.0);', 'running("patrol", 4.0);', 'stop("patrol", 4.0);'])
def test_a_missing_home_is_waited_for_until_the_limit(team, what: str) -> None:
    fleet = team('sleep(5.0); print("asks");' + attempt(what))
    fleet.run(3.0)
    fleet.power_off("bravo")
    fleet.run(20.0)
    assert count_logged(fleet, "boss: limit: ") == 1, fleet.log
    assert 3.5 < when(fleet, "limit: ") - when(fleet, "boss: asks") < 6.0
    assert count_logged(fleet, "patrol started") == 0


def test_another_missing_host_prevents_no_start(team) -> None:
    """A fallback starts because a robot is missing; the started coordinator has its own limits."""
    fleet = team("sleep(5.0);" + attempt('start("patrol", 4.0);'))
    fleet.run(3.0)
    fleet.lose("carol")
    fleet.run(20.0)
    assert (count_logged(fleet, "went on"), count_logged(fleet, "home")) == (1, 1)


def test_a_home_without_a_record_waits_for_the_reports_of_all_hosts(team) -> None:
    """The disk of the home was replaced: the coordinator may be alive on another host."""
    fleet = team(
        "sleep(12.0);" + attempt('start("patrol", 4.0);') + "sleep(8.0);" + attempt('start("patrol", 4.0);')
    )
    fleet.run(2.0)
    fleet.crash("bravo")
    fleet.lose_disk("bravo")
    fleet.power_off("carol")
    fleet.boot("bravo")
    fleet.run(18.0)
    assert (count_logged(fleet, "boss: limit: "), count_logged(fleet, "patrol started")) == (1, 0), fleet.log
    fleet.boot("carol")
    fleet.run(20.0)
    assert (count_logged(fleet, "went on"), count_logged(fleet, "patrol started")) == (1, 1), fleet.log


def test_an_ordered_stop_stays_in_force_after_its_limit(team) -> None:
    """The coordinator is on a host that is cut off; it ends when it can be reached."""
    fleet = team(
        'start("patrol", 4.0); sleep(2.0);' + attempt('stop("patrol", 3.0);'),
        deployment=DEPLOYMENT.replace("p1&3", "p2&900"),
    )
    fleet.run(2.0)
    for other in ("alpha", "bravo"):
        fleet.cut("carol", other)
    fleet.run(8.0)
    assert count_logged(fleet, "boss: limit: the time is over; patrol has not ended") == 1, fleet.log
    fleet.heal_all()
    fleet.run(15.0)
    assert count_logged(fleet, "home") == 1, fleet.log
    assert not any("patrol" in life.core.machine.agents for life in fleet.runs.values())


def test_start_and_stop_need_separate_rights(team) -> None:
    access = "coordinators:\n  boss:\n    Post: all\n    patrol: [start]\n"
    fleet = team(
        attempt('start("patrol", 4.0);')
        + attempt('stop("patrol", 4.0);')
        + 'print(awaitEnd("patrol", 9.0));',
        access,
    )
    fleet.run(20.0)
    assert (
        count_logged(
            fleet,
            "boss: access: boss may not call patrol.stop(): mission.access.yaml:4 allows start()",
        )
        == 1
    )
    assert count_logged(fleet, "boss: done") == 1


def test_an_access_file_rejects_an_unknown_action_on_a_coordinator(team) -> None:
    with pytest.raises(ProgramError) as error:
        team("", "coordinators:\n  boss:\n    patrol: [begin]\n")
    assert [found.code for found in error.value.diagnostics] == ["Y113"]


def test_a_start_that_was_made_returns_after_a_long_restart_of_the_home(team) -> None:
    """The coordinator is stored at its call, so the call runs again, after its limit."""
    fleet = team(attempt('start("patrol", 4.0);') + "sleep(60.0);")
    while not count_logged(fleet, "boss: went on"):
        fleet.run(0.001)
    fleet.power_off("bravo")
    fleet.run(10.0)
    fleet.boot("bravo")
    fleet.run(20.0)
    assert count_logged(fleet, "patrol started by boss") == 1
    assert (count_logged(fleet, "boss: limit: "), count_logged(fleet, "boss: went on")) == (0, 2), fleet.log


def test_a_limit_around_a_start_that_was_made_throws_after_a_long_restart(team) -> None:
    what = 'within (4.5) { start("patrol", 4.0); print("started"); sleep(60.0); }'
    fleet = team(attempt(what))
    while not count_logged(fleet, "patrol started by boss"):
        fleet.run(0.001)
    fleet.power_off("bravo")
    fleet.run(10.0)
    fleet.boot("bravo")
    fleet.run(20.0)
    assert (count_logged(fleet, "boss: limit: "), count_logged(fleet, "boss: went on")) == (1, 0), fleet.log


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(3))
def test_a_started_coordinator_is_recovered_and_can_be_stopped_and_started_again(team, seed: int) -> None:
    boss = 'start("patrol", 9.0); sleep(40.0); stop("patrol", 30.0); print(awaitEnd("patrol", 9.0));'
    boss += 'start("patrol", 20.0); print("again"); sleep(3.0);'
    fleet = team(boss, interval="heartbeatInterval(3.0);", deployment=DEPLOYMENT.replace("p1&3", "p2&9000"))
    fleet.run(6.0 + seed)
    fleet.power_off("carol")
    fleet.run(25.0)
    fleet.boot("carol")
    fleet.run(60.0)
    assert count_logged(fleet, "patrol recovered on this host as start 65539") == 1
    assert (count_logged(fleet, "boss: stopped"), count_logged(fleet, "boss: again")) == (1, 1), fleet.log
    assert count_logged(fleet, "patrol started by boss (start 131072)") == 1


@pytest.mark.parametrize(("argument", "status"), [("3", exit_status.DONE), ("x", exit_status.FAILED)])
def test_a_mission_lasts_until_started_coordinators_have_ended(team, argument: str, status: int) -> None:
    deployment = DEPLOYMENT.replace("p1&3", f"p1&{argument}") + "startable Patrol:never@carol?p1&1\n"
    fleet = team('start("patrol", 4.0);', deployment=deployment, lost_after=5.0)
    fleet.run(30.0)
    assert fleet.left == dict.fromkeys(("alpha", "bravo", "carol"), status), fleet.log


def test_a_coordinator_does_not_wait_for_itself(team) -> None:
    fleet = team("", deployment="//Post:p1@alpha\n//Boss:boss@alpha\nstartable Patrol:patrol@alpha?p1&1\n")
    fleet.run(5.0)
    assert count_logged(fleet, "patrol") == 0

"""The report of a mission that does not end: the position of every agent, and its awaited event."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield.errors import Stuck
from lfield.testing.mission.mission_team import MissionTeam

PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal synchronized locked() { while (true) sleep(1.0); }
    portal slow() { while (true) sleep(1.0); }
    portal work() { print("works"); sleep(2.0); } portal synchronized waits() { wait until (false); }
}
coordinator Boss {
    init(string[] arg) {
        Post one = findPost("one");
        Post two = findPost("two");
        //body
    }
}
coordinator Other {
    init(string[] arg) { sleep(1.0); findPost("one").locked(); }
}
"""
AGENTS = "//Post:one@alpha\n//Post:two@bravo\n//Boss:boss@alpha\n"


@pytest.fixture
def stuck_in(tmp_path: Path):
    """The report on a mission with this coordinator, and further agents, after some seconds."""
    teams = []

    def told(body: str, *, more: str = "", disturb=lambda team: None) -> list[str]:
        (tmp_path / "post.L").write_text(PROGRAM.replace("//body", body))
        (tmp_path / "post.dL").write_text(AGENTS + more)
        team = MissionTeam(tmp_path / "post.dL")
        teams.append(team)
        disturb(team)
        with pytest.raises(Stuck) as stuck:
            team.run(until_done=True, at_most=10.0)
        return list(stuck.value.standing)

    yield told
    for team in teams:
        team.close()


def of(agent: str, lines: list[str]) -> str:
    (line,) = (line for line in lines if line.startswith(agent))
    return line


def test_calls_of_a_together_statement_are_named(stuck_in):
    lines = stuck_in("together { one.slow(); two.slow(); }")
    assert "one.slow()" in of("boss", lines)
    assert "two.slow()" in of("boss", lines)
    lines = stuck_in("together { one.slow(); one.work(); }")
    assert of("boss", lines) == "boss on alpha: waits for one.slow() at Boss.init (post.L:12)"


def test_calls_of_futures_and_conditions_of_monitors_are_named(stuck_in):
    lines = stuck_in("future<void>[] all = {async one.slow(), async two.waits()}; print(all.race());")
    assert of("boss", lines).startswith("boss on bravo: waits for one.slow() and two.waits() at ")
    (waits,) = (line for line in lines if line.startswith("two on"))
    assert waits.startswith("two on bravo: waits until its condition holds, at Post.waits (post.L:6)")


def test_the_holder_of_an_awaited_lock_is_named(stuck_in):
    lines = stuck_in("one.locked();", more="//Other:other@bravo\n")
    assert "other on alpha: waits for one.locked() at Other.init (post.L:16)" in lines
    assert (
        "one on alpha: waits for the lock that boss holds at Post.locked (post.L:4), "
        "at Post.locked (post.L:4)" in lines
    )


def test_a_missing_coordinator_is_named(stuck_in):
    lines = stuck_in("two.work();", disturb=lambda team: team.when("post.L:12", lambda: team.crash("alpha")))
    assert of("boss", lines) == "boss is missing: it starts on alpha, which is not running"
    lines = stuck_in("two.slow();", disturb=lambda team: team.at(3.0, lambda: team.crash("bravo")))
    assert of("boss", lines) == "boss is missing: it was on bravo, which is not running"
    lines = stuck_in(
        "sleep(100.0);",
        more="//Other:other@bravo\n",
        disturb=lambda team: team.at(0.5, lambda: team.crash("bravo")),
    )
    assert of("other", lines) == "other is missing: it starts on bravo, which is not running"
    assert of("boss", lines).startswith("boss on alpha: sleeping")


def test_an_ended_coordinator_is_reported_as_ended(stuck_in):
    lines = stuck_in("one.work();", more="//Other:other@bravo\n")
    assert of("boss", lines) == "boss: done"


def test_a_paused_host_is_reported(stuck_in):
    lines = stuck_in("sleep(100.0);", disturb=lambda team: team.at(3.0, team.pause))
    assert "alpha is paused" in lines


def test_a_coordinator_that_waits_for_a_majority_is_reported(stuck_in):
    def crash(team: MissionTeam) -> None:
        team.crash("bravo")
        team.crash("charlie")

    lines = stuck_in("heartbeatInterval(5.0); one.work();", more="//@charlie\n", disturb=crash)
    text = "boss is on no host: it has not started on alpha; alpha logged: boss not started: no majority of"
    assert of("boss", lines).startswith(text)


def test_a_coordinator_in_transit_is_reported_once(stuck_in):
    body = "while (true) { one.quick(); two.quick(); }"
    lines = stuck_in(body.replace("quick", "work"))
    assert of("boss", lines)
    lines = stuck_in("together { one.slow(); two.slow(); }")
    assert of("boss", lines).count("one.slow()") == 1

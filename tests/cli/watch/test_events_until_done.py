"""`lfield events --until-done` ends with the mission, and with its status."""

from __future__ import annotations

import signal

import pytest

from lfield import exit_status

pytestmark = pytest.mark.process

PROGRAM = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal visit(int n) { print("visit " + i2s(n)); }
}
coordinator Walker {
    init(string[] arg) {
        Post[] posts = findPost();
        int n = 0;
        while (n < TIMES) {
            posts[n % 2].visit(n);
            sleep(0.2);
            n = n + 1;
        }
        END
    }
}
"""


def deployment(name: str) -> str:
    """A separate team: commands find runs by their mission."""
    return f"//Post:p@alpha\n//Post:{name}@beta\n//Walker:walker@alpha\n"


ENDLESS = PROGRAM.replace("TIMES", "1000000").replace("END", "")
SHORT = PROGRAM.replace("TIMES", "4").replace("END", "")
FATAL = PROGRAM.replace("TIMES", "2").replace("END", "int[] none = new int[0]; none[1] = 2;")


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("program", "status", "outcome"),
    [(SHORT, exit_status.DONE, "done"), (FATAL, exit_status.FAILED, "died")],
)
def test_the_command_ends_with_the_mission_and_its_status(program, status, outcome, lfield):
    mission = lfield.mission(program, deployment(outcome))
    team = lfield.start("up", "--deploy", mission, "--all", "--sim")
    team.wait_for("listening on")
    arguments = ("events", "--deploy", mission, "--until-done")
    watcher = lfield.start(*arguments, "--since", "0", "--kinds", "finished")
    assert watcher.wait() == status, watcher.said
    assert f"walker: {outcome}" in "\n".join(watcher.err)
    assert len(watcher.out) == 1
    # The mission has ended before the command starts.
    later = lfield.start(*arguments)
    assert later.wait() == status, later.said
    assert team.popen.poll() is None


@pytest.mark.few(0)
def test_a_team_that_ends_by_itself_is_recorded_to_its_end(lfield):
    mission = lfield.mission(SHORT, deployment("early"))
    watcher = lfield.start("events", "--deploy", mission, "--until-done", "--kinds", "finished")
    watcher.wait_for("unreachable")
    team = lfield.start("up", "--deploy", mission, "--all", "--sim", "--until-done")
    assert watcher.wait() == exit_status.DONE, watcher.said
    assert len(watcher.out) == 1
    assert team.wait() == exit_status.DONE


@pytest.mark.few(0)
def test_a_killed_host_that_stays_away_makes_the_end_unknown(lfield):
    mission = lfield.mission(ENDLESS, deployment("killed"))
    maps = lfield.maps(["alpha", "beta"])
    hosts = {
        host: lfield.start("up", "--deploy", mission, *maps, "--sim", "--host", host)
        for host in ("alpha", "beta")
    }
    for host in hosts.values():
        host.wait_for("listening on")
    watcher = lfield.start("events", "--deploy", mission, *maps, "--until-done", "--lost-after", "2")
    watcher.wait_for("hopped")
    for host in hosts.values():
        host.signal(signal.SIGKILL)
    assert watcher.wait() == exit_status.UNKNOWN_OUTCOME, watcher.said


@pytest.mark.few(0)
def test_without_any_host_the_command_ends(lfield):
    mission = lfield.mission(SHORT, deployment("missing"))
    watcher = lfield.start("events", "--deploy", mission, "--until-done", "--lost-after", "1")
    assert watcher.wait() == exit_status.UNAVAILABLE, watcher.said

"""Rows of coordinators in the table: the cause of death with control characters escaped, and
startable ones.
"""

import pytest
from scripted_snapshots import states_of

from lfield.cli.views import team_status_view
from lfield.wire.coordinator_messages import CoordinatorState
from lfield.wire.observer_messages import Status


def test_the_cause_of_death_is_escaped_for_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    known = CoordinatorState("tom", 7, 1, 1, "EXITED", "alpha", "died", "E: \x1b[2J[/red]:smile:\aover")
    status = Status("alpha", "127.0.0.1:1", 2.5, b"p" * 32, b"d" * 32, [], [known], [], [], [])
    team_status_view.show(states_of({"alpha": status}))
    out = capsys.readouterr().out
    assert "died: E: \\u{1b}[2J[/red]:smile:\\u{7}over" in " ".join(out.split())
    assert not any(ord(ch) < 32 and ch != "\n" for ch in out)


SEQUENCES = """
resource Desk {
    init(string[] arg) { }
    portal line(string question) { write(question + "\\n"); read(60.0); }
    portal stay() { write("stays\\n"); sleep(60.0); }
}
coordinator Patrol {
    init(string[] arg) { findDesk("desk").stay(); }
}
coordinator Planner {
    init(string[] arg) {
        Desk desk = findDesk("desk");
        desk.line("first?");
        start("patrol", 20.0);
        desk.line("second?");
        stop("patrol", 20.0);
        desk.line("third?");
    }
}
"""


@pytest.mark.process
def test_ps_shows_a_startable_coordinator_before_while_and_after_it_runs(lfield, here) -> None:
    deployment = lfield.mission(
        SEQUENCES, "//Desk:desk@alpha\nstartable Patrol:patrol@alpha\n//Planner:planner@alpha\n"
    )
    run = lfield.start("up", "--deploy", deployment, "--host", "alpha", "--until-done", stdin=True)
    output = []
    for question in ("first", "second", "third"):
        run.wait_for(rf"{question}\?")
        if question == "second":
            run.wait_for("stays")
        table = here("ps", "--deploy", deployment, status=0)
        output += [line.split()[2:4] for line in table.out if line.startswith("alpha  patrol")]
        run.popen.stdin.write(b"\n")
        run.popen.stdin.flush()
    assert output == [["startable"], ["Patrol", "in"], ["done:", "stopped"]]
    assert run.wait() == 0

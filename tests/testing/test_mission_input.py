"""Lines of input in a mission under test, on virtual time."""

from __future__ import annotations

import pytest

from lfield.errors import MissionTestError

PROGRAM = """
resource Desk {
    init(string[] arg) { }
    portal ask(real limit) emit string { return read(limit); }
}
resource Post { init(string[] arg) { } }
coordinator Asker {
    init(string[] arg) {
        while (true) {
            try { print("said " + findDesk("desk").ask(30.0)); }
            catch (RestartException e) { print("restarted"); }
            catch (TimeLimitException e) { print("nothing said"); return; }
        }
    }
}
"""
DEPLOYMENT = "//Desk:desk@alpha\n//Post:post@bravo\n//Asker:asker@bravo\n"


@pytest.fixture
def team(tmp_path, lfield_mission):
    (tmp_path / "ask.L").write_text(PROGRAM)
    (tmp_path / "ask.dL").write_text(DEPLOYMENT)
    return lfield_mission(tmp_path / "ask.dL")


def test_input_lines_are_prepared_or_entered_at_a_time(team):
    team.type_line("alpha", "before the start")
    team.run(until="said before the start")
    team.at(team.now + 10.0, lambda: team.type_line("alpha", "later"))
    team.run(until="said later")
    arrived_at = team.now
    team.run(until_done=True)
    assert team.said("nothing said") == 1
    assert team.now - arrived_at == pytest.approx(30.0, rel=0.05)


def test_a_restart_of_the_host_ends_the_wait_and_discards_stored_lines(team):
    team.run(until="waits for a line")
    team.crash("alpha")
    team.type_line("alpha", "no process")
    team.run(1.0)
    team.boot("alpha")
    team.run(until="restarted")
    team.run(5.0)
    team.type_line("alpha", "after it")
    team.run(until="said after it")
    assert team.said("no process") == 0


@pytest.mark.parametrize(("host", "text"), [("alpha", "a\nb"), ("alpha", 7), ("bravo", "x"), ("carol", "x")])
def test_invalid_input_lines_are_refused(team, host, text):
    with pytest.raises(MissionTestError):
        team.type_line(host, text)

"""A coordinator that has terminated under leases is never recovered. Whole hosts, virtual time."""

from __future__ import annotations

from pathlib import Path

import pytest

from lfield.mission.load import load_mission
from lfield.mission.mission import Mission
from lfield.simulate.fleet import Fleet

PROGRAM = """
resource Valve {
    int turns;
    init(string[] arg) { }
    portal turn() emit int { turns += 1; sleep(1.0); return turns; }
}
coordinator Boss {
    init(string[] arg) {
        heartbeatInterval(3.0);
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
#: The two ways in which a program terminates: `init` returns, or an exception is not caught.
ENDS = {"done": "return;", "died": "throw new Exception();"}


def mission(folder: Path, end: str = "done", team: str = TEAM) -> Mission:
    (folder / "mission.L").write_text(PROGRAM.replace("END", ENDS[end]))
    (folder / "mission.dL").write_text(team)
    return load_mission(folder / "mission.dL", simulate=True)


def said(fleet: Fleet, what: str) -> list[tuple[float, str, str]]:
    return [line for line in fleet.log if what in line[2]]


@pytest.mark.parametrize("end", ENDS)
def test_a_coordinator_whose_end_a_third_host_knows_is_not_recovered(tmp_path: Path, end: str) -> None:
    fleet = Fleet(mission(tmp_path, end), 1)
    fleet.run(0.8)
    fleet.cut("a", "b")
    fleet.run(8.2)
    fleet.heal_all()
    fleet.run(20.0)
    assert [where for _, where, _ in said(fleet, "turned 1")] == ["b"]
    assert not said(fleet, "recovered")
    assert not said(fleet, "turned 2")
    for life in fleet.lives.values():
        (row,) = life.core.mobility.knowledge()
        assert (row.agent, row.state, row.outcome, row.where) == ("boss", "EXITED", end, "b")

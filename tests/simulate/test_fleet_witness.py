"""A witness is a whole host without agents: it is linked, learns of ends, and ends with its team."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from lfield import exit_status
from lfield.mission import bundle
from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.simulate.host_fleet import Fleet, FleetOptions
from simulation_testing.fault_injection import FaultRates

PROGRAM = """
resource Post { int n; init(string[] arg) { } portal count() emit int { n = n + 1; return n; } }
coordinator Boss {
    init(string[] arg) {
        heartbeatInterval(3);
        for (int i = 0; i < 20; i = i + 1) {
            try { findPost("p").count(); findPost("q").count(); } catch (Exception e) { print(e.type()); }
            sleep(0.5);
        }
    }
}
"""


@pytest.fixture(scope="module", params=["deployment", "bundle"])
def mission(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Mission:
    folder: Path = tmp_path_factory.mktemp("mission")
    (folder / "mission.L").write_text(PROGRAM)
    (folder / "mission.dL").write_text("//@ground\n//Boss:boss@alpha\n//Post:p@alpha\n//Post:q@bravo\n")
    mission = load_mission(folder / "mission.dL")
    return mission if request.param == "deployment" else bundle.decode(bundle.encode(mission))


def test_a_team_with_a_witness_ends(mission: Mission) -> None:
    fleet = Fleet(mission, 3, options=FleetOptions(lost_after=60.0))
    assert set(fleet.runs) == {"alpha", "bravo", "ground"}
    fleet.run(5.0)
    ground = fleet.runs["ground"].core
    assert ground.machine.agents == {}
    assert ground.mission.recovery.members == ("alpha", "bravo", "ground")
    fleet.run(60.0)
    assert fleet.left == dict.fromkeys(("alpha", "bravo", "ground"), exit_status.DONE)


def test_a_witness_may_restart(mission: Mission) -> None:
    fleet = Fleet(mission, 5)
    first = fleet.runs["ground"]
    FaultRates(cut=2.0, kill=6.0).inject(fleet, random.Random(5), 60.0)
    fleet.run(90.0)
    assert not fleet.failed
    assert fleet.runs["ground"] is not first
    # The witness receives the end of the coordinator again, from the hosts with the record.
    rows = fleet.runs["ground"].core.mobility.known_states()
    assert [(row.agent, row.state) for row in rows] == [("boss", "EXITED")]

"""Input lines are inputs of the core: a replay has them, from the start and from checkpoints."""

from __future__ import annotations

from recorded_teams import MemoryWithBundles, compare, recorded

from lfield.host.inputs import LineEntered
from lfield.host.recording.host_records import TurnRecord
from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet, FleetOptions
from lfield.testing.mission_operator import MissionOperator

PROGRAM = """
resource Desk {
    int asked;
    init(string[] arg) { }
    portal ask(real limit) emit string {
        asked = asked + 1;
        return i2s(asked) + read(limit);
    }
}
coordinator Asker {
    init(string[] arg) {
        while (true) {
            try { print(findDesk("desk").ask(7.0)); }
            catch (TimeLimitException e) { print(e.message()); }
        }
    }
}
"""


def test_a_replay_reads_the_same_lines(tmp_path):
    (tmp_path / "ask.L").write_text(PROGRAM)
    (tmp_path / "ask.dL").write_text("//Desk:desk@alpha\n//Asker:asker@bravo\n")
    memory = MemoryWithBundles()
    fleet = Fleet(load_mission(tmp_path / "ask.dL"), 3, options=FleetOptions(record=memory))
    operator = MissionOperator(fleet, ["alpha"])
    for second in (2.0, 3.5, 61.9, 62.0, 62.1, 90.0):
        fleet.later(second, lambda: operator.type_line("alpha", "\N{ROBOT FACE} go"))
    fleet.run(130.0)
    team = recorded(fleet.mission, memory)
    fleet.close()
    entries = [
        turn.entry
        for recording in team.recordings()
        for _, turn in recording.turns_from(0)
        if isinstance(turn, TurnRecord) and isinstance(turn.entry, LineEntered)
    ]
    assert entries == [LineEntered("\N{ROBOT FACE} go")] * 6
    found = compare(team, at_checkpoints=True)
    assert found.first is None
    assert len(found.parts) >= 4

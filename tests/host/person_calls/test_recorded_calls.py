"""The replay of a recording with calls of persons has the same effects, from its start and each
checkpoint."""

from __future__ import annotations

from pathlib import Path

import pytest
from calling_person import CallingPerson
from recorded_teams import MemoryWithBundles, compare, recorded

from lfield.host.recording import flight_recorder
from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet, FleetOptions

PROGRAM = """
resource Post {
    int count;
    init(string[] arg) { }
    portal add(int n) emit int { count = count + n; return count; }
    portal wait(real seconds) emit int { sleep(seconds); return count; }
}
coordinator Holder {
    init(string[] arg) {
        Post p = findPost()[0];
        for (int n = 0; n < 100; n = n + 1) { reserve (p) { sleep(1.0); } sleep(0.5); }
    }
}
"""


@pytest.mark.few(0)
def test_calls_of_persons_are_replayed_from_a_recording(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(flight_recorder, "CHECKPOINT_INTERVAL", 0.5)
    (tmp_path / "mission.L").write_text(PROGRAM)
    (tmp_path / "mission.dL").write_text("//Post:post@alpha\n//Holder:holder@alpha\n")
    (tmp_path / "mission.access.yaml").write_text("calls: {others: all}\nassistants: [anna]\n")
    (tmp_path / "mission.devices.yaml").write_text("reservations: {wait: 60}\n")
    memory = MemoryWithBundles()
    fleet = Fleet(load_mission(tmp_path / "mission.dL"), 1, options=FleetOptions(record=memory))
    anna, bob = CallingPerson(fleet), CallingPerson(fleet, "bob")
    fleet.run(3.0)
    for n in range(6):
        anna.call("add", n)
        orders = [bob.call("wait", 2.0, limit=30.0), anna.call("wait", 5.0, limit=1.0)]
        fleet.run(1.7)
        anna.enter(orders[0])
        bob.cancel(orders[0])
        anna.call("add", "wrong", is_assistant=True)
    anna.pause()
    fleet.run(1.0)
    anna.call("add", 1)
    anna.pause(lift=True)
    fleet.run(3.0)
    team = recorded(fleet.mission, memory)
    fleet.close()
    outcomes = {found.outcome for found in (*anna.results, *bob.results)}
    assert outcomes == {"returned", "thrown", "refused"}
    found = compare(team, at_checkpoints=True)
    assert found.first is None
    assert len(found.parts) > 5

"""Multiple tiers, on virtual time: `lfield test examples/11-multiple-tiers`."""

from __future__ import annotations


def test_drone_surveys_each_cell_only_once(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    lines = {host: [line.text for line in team.log if line.host == host] for host in ("sky", "road")}
    assert [line for line in lines["sky"] if line.startswith("flight")] == [
        "flight 1: cell 1 blocked: true",
        "flight 2: cell 2 blocked: false",
        "flight 3: cell 3 blocked: false",
        "flight 4: cell 4 blocked: true",
    ]
    assert [line for line in lines["road"] if line.startswith("truck")] == [
        "truck: cell 1 is blocked, going round",
        "truck: cell 2 is free",
        "truck: cell 3 is free",
        "truck: cell 2 is free",
        "truck: cell 1 is blocked, going round",
        "truck: cell 4 is blocked, going round",
    ]

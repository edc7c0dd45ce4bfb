"""A call that was detached from its caller commands nothing more."""

from __future__ import annotations

from pathlib import Path

from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet

PROGRAM = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal wander() {
        fc.release();
        for (int i = 1; i <= 20; i = i + 1) {
            try { fc.takeoff(1.0 * i); } catch (DeviceException e) { print(e.message() + " " + e.source()); }
            sleep(0.5);
        }
        print("wandered");
    }
    portal height() emit real { return 1.0; }
}
coordinator Boss {
    init(string[] arg) {
        Post post = findPost("p");
        try { post.wander(); } catch (RestartException e) { print(e.message() + " at " + e.source()); }
        while (true) { post.height(); sleep(1.0); }
    }
}
"""


def test_a_portal_with_a_detached_caller_commands_no_device(tmp_path: Path) -> None:
    (tmp_path / "mission.L").write_text(PROGRAM)
    (tmp_path / "mission.dL").write_text("//Post:p@alpha\n//Boss:boss@alpha\n")
    fleet = Fleet(load_mission(tmp_path / "mission.dL", simulate=True), 3)

    def climbs() -> int:
        return sum(command.what == "takeoff" for command in fleet.hardware["p.fc"].record)

    def count_logged(text: str) -> int:
        return sum(text in line for _, _, line in fleet.log)

    while climbs() < 3:
        fleet.run(0.1)
    machine = fleet.runs["alpha"].core.machine
    post, boss = machine.agents["p"], machine.agents["boss"]
    assert machine.detach_caller(boss, "RestartException", "the mission is paused")
    before = climbs()
    fleet.run(15.0)
    assert count_logged("boss: the mission is paused at p") == 1
    assert climbs() <= before + 1
    assert count_logged("p: fc: the call that would command it was taken from its caller fc") >= 15
    assert count_logged("p: wandered") == 1
    # Both continue.
    served = post.served
    assert post.ended == boss.ended == ""
    fleet.run(5.0)
    assert post.served > served

"""A confirmation that waits for the disk while the coordinator returns and leaves its call again."""

from __future__ import annotations

from pathlib import Path

from lfield.mission.loader import load_mission
from lfield.replication.transfer.effects import MarkMigrated
from lfield.simulate.host_fleet import Fleet
from lfield.vm.memory.layout import W_SEQUENCE

PROGRAM = """
resource Post {
    init(string[] arg) { }
    portal visit() { }
}
coordinator Walker {
    init(string[] arg) {
        Post far = findPost("b");
        far.visit();
        findPost("a").visit();
        sleep(1.0);
        far.visit();
    }
}
"""


def waiting_fleet(folder: Path) -> Fleet:
    """A team whose coordinator has hopped to b and back, and waits frozen on a for the lost link to b."""
    (folder / "mission.L").write_text(PROGRAM)
    (folder / "mission.dL").write_text("//Post:a@a\n//Post:b@b\n//Walker:walker@a\n")
    fleet = Fleet(load_mission(folder / "mission.dL", simulate=True), 1)
    fleet.run(0.8)
    fleet.cut("a", "b")
    fleet.run(2.0)
    return fleet


def test_the_confirmation_of_an_earlier_hop_does_not_remove_the_copy_that_returned(tmp_path: Path) -> None:
    core = waiting_fleet(tmp_path).runs["a"].core
    agent = core.machine.agents["walker"]
    sequence = agent.block.w[W_SEQUENCE]
    assert agent.frozen
    assert sequence == 2, "it has left for b and returned"
    executor = core.coordinators._executor
    executor.execute(MarkMigrated("walker", agent.generation, sequence - 1, "b"))
    assert core.machine.agents.get("walker") is agent
    executor.execute(MarkMigrated("walker", agent.generation, sequence, "b"))
    assert "walker" not in core.machine.agents

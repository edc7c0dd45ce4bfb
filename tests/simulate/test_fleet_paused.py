"""A pause and the rest of its devices outlast a restart of the host. In virtual time."""

from __future__ import annotations

from pathlib import Path
from secrets import token_bytes

from lfield.mission.loader import load_mission
from lfield.simulate.host_fleet import Fleet, HostRun
from lfield.testing.mission_operator import OperatorLink
from lfield.wire.observer_messages import Pause, with_epoch

PROGRAM = """
resource Post {
    Mavlink fc;
    init(string[] arg) { }
    portal climb(real height) { fc.takeoff(height); print("climbs to " + f2s(height, 0)); }
}
coordinator Walker {
    init(string[] arg) {
        Post post = findPost()[0];
        for (int n = 2; n < 1000; n = n + 1) {
            try { post.climb(i2f(n)); }
            catch (RestartException told) { print("told"); }
            sleep(0.5);
        }
    }
}
"""


def say(life: HostRun, *, lift: bool) -> None:
    order = with_epoch(Pause(token_bytes(16), lift), life.core.orders.epochs)
    life.process.loop.enter(lambda: life.host.on_message("", order, OperatorLink()))


def latched(fleet: Fleet) -> str:
    (device,) = fleet.runs["alpha"].host.status().devices
    return device.latched


def test_the_devices_of_a_host_restarted_during_a_pause_are_held(tmp_path: Path) -> None:
    (tmp_path / "mission.L").write_text(PROGRAM)
    (tmp_path / "mission.dL").write_text("//Post:p@alpha\n//Walker:walker@alpha\n")
    fleet = Fleet(load_mission(tmp_path / "mission.dL", simulate=True), 1)
    fleet.run(8.0)
    say(fleet.runs["alpha"], lift=False)
    fleet.run(5.0)
    assert latched(fleet) == "the mission is paused"
    fleet.crash("alpha")
    fleet.boot("alpha")
    started = len(fleet.log)
    fleet.run(10.0)
    assert latched(fleet) == "the mission is paused"
    assert not [text for _, _, text in fleet.log[started:] if "climbs" in text]
    say(fleet.runs["alpha"], lift=True)
    fleet.run(10.0)
    assert latched(fleet) == ""
    assert [text for _, _, text in fleet.log[started:] if "climbs" in text]

"""A command of a program begins in time or not at all, after any suspension. In virtual time."""

from __future__ import annotations

import random
import re

import pytest

from lfield.mission.loader import load_mission
from lfield.mission.mission import Mission
from lfield.simulate.host_fleet import Fleet
from simulation_testing.fault_injection import FaultRates

PROGRAM = """
resource Post {
    Mavlink fc;
    int count;
    init(string[] arg) { }
    portal free() {
        fc.release();
        print("free");
    }
    portal climb() {
        count = count + 1;
        print("climb " + i2s(count));
        fc.takeoff(1.0 * count);
    }
}
coordinator Walker {
    init(string[] arg) {
        Post post = findPost()[0];
        while (true) {
            try {
                post.free();
                sleep(0.2);
                post.climb();
            } catch (Exception refused) { print("refused: " + refused.message()); }
            sleep(0.2);
        }
    }
}
"""
#: The default time-to-live of a device, and how long a call of it may take to begin.
TTL = 0.5


@pytest.fixture(scope="module")
def mission(tmp_path_factory: pytest.TempPathFactory) -> Mission:
    folder = tmp_path_factory.mktemp("mission")
    (folder / "mission.L").write_text(PROGRAM)
    (folder / "mission.dL").write_text("//Post:p@alpha\n//Walker:walker@alpha\n")
    return load_mission(folder / "mission.dL", simulate=True)


def called_at(fleet: Fleet) -> dict[float, float]:
    """The true time of the program's call of each climb, by its height."""
    climbs = ((at, re.search(r"climb (\d+)", text)) for at, _, text in fleet.log)
    return {float(found[1]): at for at, found in climbs if found}


def begun_at(fleet: Fleet) -> dict[float, float]:
    """The time at which the vehicle received each command."""
    record = fleet.hardware["p.fc"].record
    return {float(str(command.arguments[0])): command.at for command in record if command.what == "takeoff"}


def frees(mission: Mission, seed: int) -> Fleet:
    """Run until the vehicle is released, 0.2 s before a climb: no silence of the host holds it yet."""
    fleet = Fleet(mission, seed)
    while not any("free" in text for _, _, text in fleet.log):
        fleet.run(0.01)
    return fleet


def refusals(fleet: Fleet) -> str:
    return "".join(text for _, _, text in fleet.log if "refused" in text)


def test_a_call_delayed_in_the_pipe_of_a_suspended_guard_is_not_executed(
    mission: Mission,
) -> None:
    fleet = frees(mission, 1)
    (guard,) = fleet.runs["alpha"].process.children
    guard.loop.freeze()
    fleet.run(0.2 + TTL + 0.3)
    guard.loop.thaw()
    fleet.run(0.1)
    assert 1.0 in called_at(fleet)
    assert 1.0 not in begun_at(fleet)
    # By the clock of its computer, which may be slow or fast.
    text = r"takeoff\(\) had to start within 0\.5 s, but reached its guard after 0\.(79|80)\d? s"
    assert re.search(text, refusals(fleet))


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(2))
def test_under_any_suspension_no_call_begins_after_its_time(mission: Mission, seed: int) -> None:
    fleet = Fleet(mission, seed)
    storm = FaultRates(guard_stop=1.5, stop=4.0).inject(fleet, random.Random(seed))
    fleet.run(120.0)
    called, started_times = called_at(fleet), begun_at(fleet)
    late = {n: at - called[n] for n, at in started_times.items() if at - called[n] > TTL * 1.001}
    assert late == {}
    assert len(storm.faults) > 40
    assert len(started_times) > 10

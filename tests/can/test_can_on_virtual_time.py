"""Drives in a mission on virtual time: their driver, guard and fake in one process, without a thread."""

from __future__ import annotations

import threading

import pytest

MISSION = """
resource Mill {
    CanAxis axis;
    init(string[] arg) { }
    portal turn(real angle) emit real {
        axis.enable();
        axis.moveTo(angle, 5.0);
        return axis.position();
    }
}
coordinator Boss {
    init(string[] arg) {
        print("the first is at " + f2s(findMill("first").turn(2.0), 1));
        print("the second is at " + f2s(findMill("second").turn(-3.0), 1));
    }
}
"""
HOSTS = "//Mill:first@alpha\n//Mill:second@bravo\n//Boss:boss@alpha\n"
DEVICES = """
agents:
  first:
    devices:
      axis:
        driver: can
        type: CanAxis
        endpoint: socketcan:can0
        protocol: cia402
        node: 5
        counts: 4096
        limits: {speed: 20.0}
        safe_state: brake
        waivers: [no_homing]
  second:
    devices:
      axis:
        driver: can
        type: CanAxis
        endpoint: socketcan:can0
        protocol: odrive
        node: 3
        limits: {speed: 20.0}
        safe_state: brake
        waivers: [device_watchdog, no_homing]
"""


@pytest.fixture
def mills(tmp_path, lfield_mission):
    def made(**options):
        (tmp_path / "mill.L").write_text(MISSION)
        (tmp_path / "mill.dL").write_text(HOSTS)
        (tmp_path / "mill.devices.yaml").write_text(DEVICES)
        return lfield_mission(tmp_path / "mill.dL", **options)

    return made


def test_drives_turn_without_a_thread(mills):
    before = threading.active_count()
    team = mills()
    team.run(until_done=True)
    assert team.ended == {"boss": "done"}
    assert team.said("the first is at 2.0")
    assert team.said("the second is at -3.0")
    assert threading.active_count() == before


@pytest.mark.few(0)
def test_same_seed_gives_the_same_log_on_a_lossy_bus(mills):
    """SDO requests and answers are lost and repeated, on virtual time."""
    logs = []
    for _ in range(2):
        team = mills(fakes={"first.axis": ["loss=0.02"]}, seed=1)
        team.run(until_done=True)
        logs.append(team.log)
    assert logs[0] == logs[1]

"""Loops of resources in missions on virtual time: devices, pauses, stops, restarts, lost links, the end."""

from __future__ import annotations

import math

import pytest

from lfield.testing.mission.mission_team import MissionTeam

PROGRAM = """
resource Rover {
    Mavlink fc;
    int ticks;
    boolean away;
    boolean near;
    boolean broken;
    init(string[] arg) { }
    loop count at 2.0 { ticks += 1; print("tick " + i2s(ticks)); }
    loop stay at 10 priority 2 when (near) {
        print("stay");
        fc.hold();
        near = false;
        sleep(1);
    }
    loop drive at 5 priority 1 when (away) {
        fc.goTo(30, 0, 0);
        away = false;
    }
    loop fail at 5 when (broken) { int[] none = {}; print(none[1]); }
    portal start() { fc.waitReady(60.0); fc.arm(); away = true; }
    portal meet() { near = true; }
    portal breakDown() { broken = true; }
    portal move() { fc.goTo(0, 10, 0); }
    portal busy() emit boolean { return drive.running(); }
}
coordinator Boss {
    init(string[] arg) {
        Rover rover = findRover("rover");
        try {
            rover.start();
            //body
        } catch (Exception e) { print(e.type() + " " + e.message()); }
        print("finished");
        //end
    }
}
"""
DEPLOYMENT = "//Rover:rover@field\n//Boss:boss@desk\n"
DEVICES = """
agents:
  rover:
    devices:
      fc:
        {driver: mavlink, endpoint: "udp:127.0.0.1:14560", system: 2, kind: rover, safe_state: hold,
         limits: {speed: 3.0, radius: 60.0}, waivers: [device_watchdog]}
"""


@pytest.fixture
def rover(tmp_path, lfield_mission):
    """Makes a team of a rover and a coordinator that executes `body`, and `end` in any case."""

    def made(body: str, end: str = "", witness: str = "", **options: object) -> MissionTeam:
        (tmp_path / "rover.L").write_text(PROGRAM.replace("//body", body).replace("//end", end))
        (tmp_path / "rover.dL").write_text(DEPLOYMENT + witness)
        (tmp_path / "rover.devices.yaml").write_text(DEVICES)
        return lfield_mission(tmp_path / "rover.dL", **options)

    return made


def moved(team: MissionTeam) -> float:
    """The distance of the rover from its start, in metres."""
    track = team.tracks["rover.fc"]
    return math.dist((track[-1].north, track[-1].east), (track[0].north, track[0].east))


def stands(team: MissionTeam) -> bool:
    before = moved(team)
    team.run(2.0)
    return abs(moved(team) - before) < 0.5


@pytest.mark.few(0)
def test_an_upper_loop_cancels_the_motion_of_a_lower_one(rover):
    team = rover("sleep(6); rover.meet(); sleep(0.5); rover.move();")
    team.run(until="stay")
    assert moved(team) > 3.0
    assert team.said("loop drive of rover suppressed by stay") == 1
    team.run(until="finished")
    # The portal is refused while the upper body runs.
    assert team.said("DeviceException fc: the loop stay controls the devices now") == 1
    # Its condition has ended, and the lower loop continues to drive.
    team.run(3.0)
    assert not stands(team)


def test_loops_do_not_keep_a_mission_alive(rover):
    team = rover("")
    team.run(until_done=True)
    assert team.ended == {"boss": "done"}
    assert team.said("tick 2") == 1


def test_an_error_in_a_loop_stops_the_devices(rover):
    team = rover("sleep(6); rover.breakDown(); sleep(9); rover.move();", "sleep(20);")
    team.run(until="rover died of an uncaught IndexException")
    assert moved(team) > 3.0
    team.run(4.0)
    assert stands(team)
    team.run(until="finished")
    assert team.said("UnreachableResourceException rover is not available: it died of IndexException") == 1


def test_a_pause_stops_the_ticks_and_skips_missed_ones(rover):
    team = rover("sleep(30);")
    team.run(until="tick 12")
    team.pause()
    team.run(5.0)
    assert team.said("tick 13") == 0
    assert stands(team)
    team.resume()
    team.run(0.9)
    assert 1 <= sum(line.text.startswith("rover: tick") for line in team.log) - 12 <= 3


def test_a_stop_ends_the_ticks_before_the_devices_are_safe(rover):
    team = rover("sleep(60);")
    team.run(until="tick 12")
    team.stop()
    ticks = [line.at for line in team.log if line.text.startswith("rover: tick")]
    assert len(ticks) == 12
    assert team.said("loop-failed") == team.said("loop drive of rover failed") == 0


@pytest.mark.few(0)
def test_loops_run_without_network_and_restart_with_their_host(rover):
    team = rover("sleep(60);")
    team.run(until="tick 12")
    team.cut("field", "desk")
    team.run(4.0)
    assert team.said("tick 19") == 1
    team.heal("field", "desk")
    team.crash("field")
    team.run(3.0)
    team.boot("field")
    team.run(6.0)
    assert sum(line.text == "rover: tick 1" for line in team.log) == 2


def test_a_lost_lease_stops_the_devices_of_its_coordinator_but_not_the_loops(rover):
    """The coordinator has used the device, so a loop cannot move it either, until a release."""
    team = rover("heartbeatInterval(2.0); rover.start(); sleep(60);", witness="//@base\n")
    team.run(until="tick 12")
    team.cut("field", "desk")
    team.cut("field", "base")
    team.run(until="in safe state 'hold': the lease of field has ended")
    team.run(6.0)
    assert stands(team)
    assert team.said("tick 28") == 1
    team.run(until="held in its safe state: the lease of field has ended")
    assert team.said("loop drive of rover failed: DeviceException") == 2
    team.heal("field", "desk")
    team.run(6.0)
    assert stands(team)


@pytest.mark.few(0)
def test_the_same_seed_is_the_same_run(rover):
    logs = []
    for _ in range(2):
        team = rover("sleep(6); rover.meet(); sleep(3);", seed=7)
        team.run(until_done=True)
        logs.append([(line.at, line.text) for line in team.log])
    assert logs[0] == logs[1]

"""Vehicles of one team that were switched on at different places, and move to one another's positions."""

from __future__ import annotations

import math

import pytest

MISSION = """
include <mavlink/copter.L>;
include <mavlink/rover.L>;

coordinator Boss {
    init(string[] arg) {
        Rover car = findRover("car");
        car.driveTo(12.0, 5.0);
        real[] at = car.position();
        print("car " + f2s(at[0]) + " " + f2s(at[1]) + " " + f2s(at[2]));
        Copter low = findCopter("low");
        low.flyTo(at[0], at[1], -6.0);
        at = low.position();
        print("low " + f2s(at[0]) + " " + f2s(at[1]) + " " + f2s(at[2]));
        Copter high = findCopter("high");
        high.flyTo(at[0], at[1], at[2] - 3.0);
        at = high.position();
        print("high " + f2s(at[0]) + " " + f2s(at[1]) + " " + f2s(at[2]));
        high.lookAt(at[0] + 10.0, at[1], at[2]);
        print("heading " + f2s(high.heading()));
        high.move(1.0, 0.0, 0.0, 2.0);
        print("met");
        high.climb(2.0);
        at = high.position();
        print("climbed " + f2s(at[0]) + " " + f2s(at[1]) + " " + f2s(at[2]));
    }
}
"""
TEAM = "//Rover:car@ground\n//Copter:low@alpha\n//Copter:high@bravo\n//Boss:boss@ground\n"
# : A team on the Earth, whose vehicles know their positions; and a hall, where each has a pose, some turned.
EARTH = """\
frame: {origin: {latitude: -35.363262, longitude: 149.165237, altitude: 584.0}}
agents:
  car: {devices: {fc: {DRIVER, endpoint: "udp:h:1", system: 1, kind: rover, sim: [north=30, east=-40]}}}
  low: {devices: {fc: {DRIVER, endpoint: "udp:h:2", system: 2}}}
  high: {devices: {fc: {DRIVER, endpoint: "udp:h:3", system: 3, autopilot: px4, sim: [north=-25, east=60]}}}
"""
HALL = """\
hosts: {ground: {frame: {north: 30, east: -40}}}
agents:
  car: {devices: {fc: {DRIVER, endpoint: "udp:h:1", system: 1, kind: rover}}}
  low:
    frame: {north: 3, east: 5, down: 1.5, heading: 2.0}
    devices: {fc: {DRIVER, endpoint: "udp:h:2", system: 2}}
  high:
    frame: {north: -25, east: 60, down: -4.0, heading: -1.0}
    devices: {fc: {DRIVER, endpoint: "udp:h:3", system: 3, autopilot: px4}}
"""
DRIVER = "driver: mavlink, waivers: [device_watchdog], limits: {speed: 10.0}"


@pytest.fixture
def team(tmp_path, lfield_mission):
    """The team of some bindings, after all vehicles have moved to the meeting point."""

    def run(devices):
        (tmp_path / "m.L").write_text(MISSION)
        (tmp_path / "m.dL").write_text(TEAM)
        (tmp_path / "m.devices.yaml").write_text(devices.replace("DRIVER", DRIVER))
        team = lfield_mission(tmp_path / "m.dL")
        team.run(until_done=True)
        assert team.ended == {"boss": "done"}, [line.text for line in team.log]
        return team

    return run


def reported_position(team, who):
    """The reported position of a vehicle, and its time."""
    (line,) = [line for line in team.log if line.text.startswith(f"boss: {who} ")]
    return line.at, [float(word) for word in line.text.split()[2:]]


def truth(team, who, moment):
    point = min(team.tracks[f"{who}.fc"], key=lambda point: abs(point.at - moment))
    return [point.north, point.east, -point.up]


@pytest.mark.few(0)
@pytest.mark.parametrize("devices", [EARTH, HALL], ids=["earth", "hall"])
def test_a_vehicle_sent_to_anothers_position_arrives_there(team, devices):
    team = team(devices)
    starts = [points[0][1:3] for points in team.tracks.values()]
    assert min(math.dist(a, b) for a in starts for b in starts if a is not b) > 4.0
    for name in ("car", "low", "high"):
        moment, place = reported_position(team, name)
        assert math.dist(place, truth(team, name, moment)) < 0.35, name
    # ArduPilot stops a rover within 2 m of its goal.
    assert math.dist(reported_position(team, "car")[1][:2], (12.0, 5.0)) < 2.1
    assert math.dist(reported_position(team, "low")[1][:2], reported_position(team, "car")[1][:2]) < 0.6
    assert reported_position(team, "low")[1][2] == pytest.approx(-6.0, abs=0.6)
    assert math.dist(reported_position(team, "high")[1][:2], reported_position(team, "low")[1][:2]) < 0.6
    assert reported_position(team, "high")[1][2] == pytest.approx(
        reported_position(team, "low")[1][2] - 3.0, abs=0.6
    )
    # Headings and velocities are of the team's north, too.
    (heading,) = reported_position(team, "heading")[1]
    assert math.remainder(heading, math.tau) == pytest.approx(0.0, abs=0.1)
    started = reported_position(team, "heading")[0]
    (met,) = [line.at for line in team.log if line.text == "boss: met"]
    # In the first second it still decelerates.
    before, then = truth(team, "high", started + 1.0), truth(team, "high", met)
    assert then[0] - before[0] > 0.5
    assert then[1] == pytest.approx(before[1], abs=0.4)
    climbed = reported_position(team, "climbed")[1]
    assert climbed[2] == pytest.approx(then[2] - 2.0, abs=0.6)
    assert math.dist(climbed[:2], then[:2]) < 1.0


CLIMB = """
include <mavlink/copter.L>;
coordinator Boss {
    init(string[] arg) {
        Copter low = findCopter("low");
        low.flyTo(TO);
        low.land();
        print("climbs");
        low.climb(3.0);
        print("there");
    }
}
"""


@pytest.mark.few(0)
@pytest.mark.parametrize(
    ("frame", "to"),
    [
        ("", "12.0, 0.0, -4.0"),
        ("frame: {north: 50, east: 20, down: -7, heading: 1.0}, ", "56.0, 31.0, -11.0"),
    ],
    ids=["home", "frame"],
)
def test_a_climb_after_a_landing_is_vertical(tmp_path, lfield_mission, frame, to):
    """Home moves to the place of arming, which changes earlier positions in that frame."""
    (tmp_path / "m.L").write_text(CLIMB.replace("TO", to))
    (tmp_path / "m.dL").write_text("//Copter:low@alpha\n//Boss:boss@alpha\n")
    bound = f"low: {{{frame}devices: {{fc: {{{DRIVER}, endpoint: 'udp:h:1'}}}}}}"
    (tmp_path / "m.devices.yaml").write_text(f"agents:\n  {bound}\n")
    team = lfield_mission(tmp_path / "m.dL")
    team.run(until="climbs")
    landed = truth(team, "low", team.now)
    team.run(until="there")
    climbed = truth(team, "low", team.now)
    assert math.dist(landed[:2], climbed[:2]) < 1.0
    assert climbed[2] - landed[2] == pytest.approx(-3.0, abs=0.5)

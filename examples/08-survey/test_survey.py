"""A survey, on virtual time: `lfield test examples/08-survey`."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import survey_times
from survey_times import deployment, uncovered

#: A field of 28 by 36 m, metres east and north of the start: two strips.
SMALL = [(-14.0, 12.0), (14.0, 12.0), (14.0, 48.0), (-14.0, 48.0)]
#: A field with two strips of 6 m.
TINY = [(-14.0, 3.0), (14.0, 3.0), (14.0, 9.0), (-14.0, 9.0)]
#: A field with one strip.
NARROW = [(-7.0, 12.0), (7.0, 12.0), (7.0, 48.0), (-7.0, 48.0)]


def strip_vehicles(team):
    """The vehicle that has flown each strip, according to the log."""
    return {
        int(number): vehicle
        for number, vehicle in re.findall(r"strip (\d+) is flown by (\w+)", log_text(team))
    }


def log_text(team):
    return "\n".join(line.text for line in team.log)


def table_row(vehicles):
    """The numbers in a row of the README's table."""
    readme = (Path(__file__).parent / "README.md").read_text(encoding="utf-8")
    row = re.search(rf"^\| {vehicles} \| (\d+) s \| (\d+) \| (\d+) \|$", readme, re.MULTILINE)
    return tuple(map(int, row.groups()))


def run_until_on_strip(team):
    """Run until the vehicle that the coordinator visited last is on its strip. Return both vehicles."""
    team.run(until=lambda: team.said(" takes part: ") == 2, at_most=90.0)
    team.run(2.0)  # until the coordinator has visited both vehicles
    vehicles = re.findall(r"(\w+) takes part", log_text(team))
    host = next(hop.target for hop in reversed(team.hops) if hop.target != "base")
    last_visited = host.replace("copter", "m")
    track = team.tracks[f"{last_visited}.fc"]
    team.run(until=lambda: track[-1].north > 20.0 and 24.0 < track[-1].up < 26.0, at_most=300.0)
    return last_visited, next(vehicle for vehicle in vehicles if vehicle != last_visited)


def assert_other_flies_all_strips(team, path, failed, other, strips=2):
    """Run the survey to its end: the other vehicle flies all strips, and each point is in a picture."""
    team.run(until_done=True, at_most=survey_times.MAX_DURATION)
    assert team.ended == {"survey": "done"}
    assert strip_vehicles(team) == dict.fromkeys(range(strips), other)
    assert team.said(f"{failed} is out, strip ") == 1
    assert uncovered(team, path.with_name("field.kml")) == []


def keep_first_copters(path, count):
    """Remove all but the first copters from the mission."""
    path.write_text(re.sub(rf"//Mapper:m[{count + 1}-4].*\n", "", path.read_text()))
    devices = path.with_name("mission.devices.yaml")
    devices.write_text(devices.read_text().partition(f"  m{count + 1}:")[0])


@pytest.mark.few(0)
def test_single_vehicle_flies_all_strips(lfield_mission, tmp_path):
    path = deployment(tmp_path, 1, TINY)
    keep_first_copters(path, 1)
    team = lfield_mission(path)
    team.run(until_done=True, at_most=survey_times.MAX_DURATION)
    assert team.ended == {"survey": "done"}
    assert strip_vehicles(team) == {0: "m1", 1: "m1"}
    assert team.said("2 of 2 strips, 4 pictures") == 1
    assert uncovered(team, path.with_name("field.kml")) == []
    assert team.tracks["m1.fc"][-1].up < 0.2, "m1 must land"


@pytest.mark.few(0)
def test_other_vehicle_flies_the_strip_of_a_lost_computer(lfield_mission, tmp_path):
    path = deployment(tmp_path, 2, SMALL)
    team = lfield_mission(path)
    failed, other = run_until_on_strip(team)
    team.crash(failed.replace("m", "copter"))
    assert_other_flies_all_strips(team, path, failed, other)


@pytest.mark.few(0)
def test_survey_continues_after_the_loss_of_the_base_computer(lfield_mission, tmp_path):
    path = deployment(tmp_path, 2, TINY)
    keep_first_copters(path, 2)
    team = lfield_mission(path)
    team.run(20.0)
    assert team.hops[-1].target == "base"
    team.crash("base")
    team.run(until_done=True, at_most=survey_times.MAX_DURATION)
    assert team.ended == {"survey": "done"}
    assert sorted(strip_vehicles(team)) == [0, 1]
    for vehicle in ("m1", "m2"):
        assert team.said(f"{vehicle} continues, strip ") == 1
        assert team.said(f"{vehicle}.fc released from its safe state") == 1
        assert team.tracks[f"{vehicle}.fc"][-1].up < 0.2, "the vehicle must land"
    assert uncovered(team, path.with_name("field.kml")) == []


@pytest.mark.few(0)
def test_coordinator_lost_with_a_copters_computer_is_recovered(lfield_mission, tmp_path):
    path = deployment(tmp_path, 2, SMALL)
    keep_first_copters(path, 2)
    team = lfield_mission(path)
    source = path.with_name("mission.L").read_text().splitlines()
    line_of_result = next(number for number, text in enumerate(source, 1) if '" is flown by "' in text)
    crashed = []

    def crash_coordinators_host():
        crashed.append(team.hops[-1].target)
        team.crash(crashed[0])

    team.when(f"mission.L:{line_of_result}", crash_coordinators_host)
    team.run(until=lambda: bool(crashed), at_most=survey_times.MAX_DURATION)
    failed = crashed[0].replace("copter", "m")
    other = {"m1": "m2", "m2": "m1"}[failed]
    assert_other_flies_all_strips(team, path, failed, other)
    assert team.said(f"{other} continues, strip ") == 1


@pytest.mark.few(0)
def test_recovered_coordinator_does_not_override_a_pilot(lfield_mission, tmp_path):
    path = deployment(tmp_path, 2, SMALL)
    keep_first_copters(path, 2)
    team = lfield_mission(path)
    team.run(until=lambda: team.said(" is flown by m1") == 1, at_most=survey_times.MAX_DURATION)
    team.fake("m2.fc").set("sticks=true")
    team.run(0.3)
    team.crash("copter1")
    team.run(until_done=True, at_most=survey_times.MAX_DURATION)
    assert team.said("m2 is out, strip ") == 1
    assert team.said("m2.fc released") == 0
    assert team.fake("m2.fc").facts["mode"] == "POSCTL"


@pytest.mark.few(0)
@pytest.mark.parametrize("fault", ["silence", "motor_failure"])
def test_other_vehicles_fly_the_strip_of_a_failed_one(lfield_mission, tmp_path, fault):
    path = deployment(tmp_path, 2, SMALL)
    team = lfield_mission(path)
    failed, other = run_until_on_strip(team)
    team.fake(f"{failed}.fc").set(f"{fault}=true")
    assert_other_flies_all_strips(team, path, failed, other)


@pytest.mark.few(0)
def test_waiting_vehicle_flies_the_only_strip_of_a_failed_one(lfield_mission, tmp_path):
    path = deployment(tmp_path, 2, NARROW)
    team = lfield_mission(path)
    failed, other = run_until_on_strip(team)
    team.fake(f"{failed}.fc").set("motor_failure=true")
    assert_other_flies_all_strips(team, path, failed, other, strips=1)


@pytest.mark.few(0)
def test_four_vehicles_chosen_by_the_registry_share_the_field(lfield_mission, tmp_path):
    path = deployment(tmp_path, 4)
    team = lfield_mission(path)
    team.run(until_done=True, at_most=survey_times.MAX_DURATION)
    assert team.ended == {"survey": "done"}
    assert sorted(strip_vehicles(team)) == list(range(9))
    assert set(strip_vehicles(team).values()) == {"m1", "m2", "m3", "m4"}
    assert uncovered(team, path.with_name("field.kml")) == []
    assert table_row("4")[1:] == (9, 0)
    assert all(track[-1].up < 0.2 for track in team.tracks.values()), "all vehicles must land"

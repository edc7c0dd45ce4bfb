"""A survey, on virtual time: `lfield test examples/08-survey`."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import survey_times
from survey_times import deployment, uncovered

#: A field of 28 by 36 m, metres east and north of the start: two strips.
SMALL = [(-14.0, 12.0), (14.0, 12.0), (14.0, 48.0), (-14.0, 48.0)]
#: Two strips of 6 m.
TINY = [(-14.0, 3.0), (14.0, 3.0), (14.0, 9.0), (-14.0, 9.0)]
#: One strip.
NARROW = [(-7.0, 12.0), (7.0, 12.0), (7.0, 48.0), (-7.0, 48.0)]


def flown(team):
    """The vehicle of each strip, by the log."""
    return {int(number): who for number, who in re.findall(r"strip (\d+) is flown by (\w+)", log(team))}


def log(team):
    """The lines of all hosts."""
    return "\n".join(line.text for line in team.log)


def row(vehicles):
    """The numbers of a row of the table of the page."""
    page = (Path(__file__).parent / "README.md").read_text(encoding="utf-8")
    found = re.search(rf"^\| {vehicles} \| (\d+) s \| (\d+) \| (\d+) \|$", page, re.MULTILINE)
    return tuple(map(int, found.groups()))


def last_on_a_strip(team):
    """The vehicle that the coordinator has visited last, in the middle of its strip, and the other of two."""
    team.run(until=lambda: team.said(" takes part: ") == 2, at_most=90.0)
    team.run(2.0)  # for its first visits
    chosen = re.findall(r"(\w+) takes part", log(team))
    victim = next(hop.target for hop in reversed(team.hops) if hop.target != "base").replace("copter", "m")
    track = team.tracks[f"{victim}.fc"]
    team.run(until=lambda: track[-1].north > 20.0 and 24.0 < track[-1].up < 26.0, at_most=300.0)
    return victim, next(who for who in chosen if who != victim)


def finish(team, path, victim, other, strips=2):
    """Runs it to its end: the other one has flown everything, and no point is without a picture."""
    team.run(until_done=True, at_most=survey_times.AT_MOST)
    assert team.ended == {"survey": "done"}
    assert flown(team) == dict.fromkeys(range(strips), other)
    assert team.said(f"{victim} is out, strip ") == 1
    assert uncovered(team, path.with_name("field.kml")) == []


def small_team(path, count):
    """Leaves the first copters only in the mission."""
    gone = "".join(str(number) for number in range(count + 1, 5))
    path.write_text(re.sub(rf"//Mapper:m[{gone}].*\n", "", path.read_text()))
    devices = path.with_name("mission.devices.yaml")
    devices.write_text(devices.read_text().partition(f"  m{count + 1}:")[0])


@pytest.mark.few(0)
def test_one_vehicle_flies_one_strip_after_the_other(lfield_mission, tmp_path):
    path = deployment(tmp_path, 1, TINY)
    small_team(path, 1)
    team = lfield_mission(path)
    team.run(until_done=True, at_most=survey_times.AT_MOST)
    assert team.ended == {"survey": "done"}
    assert flown(team) == {0: "m1", 1: "m1"}
    assert team.said("2 of 2 strips, 4 pictures") == 1
    assert uncovered(team, path.with_name("field.kml")) == []
    assert team.tracks["m1.fc"][-1].up < 0.2, "it has landed"


@pytest.mark.few(0)
def test_other_vehicle_flies_the_strip_of_a_lost_computer(lfield_mission, tmp_path):
    path = deployment(tmp_path, 2, SMALL)
    team = lfield_mission(path)
    victim, other = last_on_a_strip(team)
    team.crash(victim.replace("m", "copter"))
    finish(team, path, victim, other)


def test_survey_continues_without_the_computer_of_its_base(lfield_mission, tmp_path):
    path = deployment(tmp_path, 2, TINY)
    small_team(path, 2)
    team = lfield_mission(path)
    team.run(20.0)
    assert team.hops[-1].target == "base"
    team.crash("base")
    team.run(until_done=True, at_most=survey_times.AT_MOST)
    assert team.ended == {"survey": "done"}
    assert sorted(flown(team)) == [0, 1]
    for who in ("m1", "m2"):
        assert team.said(f"{who} continues, strip ") == 1
        assert team.said(f"{who}.fc released from its safe state") == 1
        assert team.tracks[f"{who}.fc"][-1].up < 0.2, "it has landed"
    assert uncovered(team, path.with_name("field.kml")) == []


@pytest.mark.few(0)
def test_survey_that_is_lost_with_the_computer_that_it_visits_is_recovered(lfield_mission, tmp_path):
    path = deployment(tmp_path, 2, SMALL)
    small_team(path, 2)
    team = lfield_mission(path)
    source = path.with_name("mission.L").read_text().splitlines()
    fetched = next(number for number, text in enumerate(source, 1) if '" is flown by "' in text)
    victims = []

    def crash():
        """On the computer of the first copter at the end of its strip."""
        victims.append(team.hops[-1].target)
        team.crash(victims[0])

    team.when(f"mission.L:{fetched}", crash)
    team.run(until=lambda: bool(victims), at_most=survey_times.AT_MOST)
    victim = victims[0].replace("copter", "m")
    other = {"m1": "m2", "m2": "m1"}[victim]
    finish(team, path, victim, other)
    assert team.said(f"{other} continues, strip ") == 1


@pytest.mark.few(0)
def test_recovered_survey_leaves_a_copter_to_its_pilot(lfield_mission, tmp_path):
    path = deployment(tmp_path, 2, SMALL)
    small_team(path, 2)
    team = lfield_mission(path)
    team.run(until=lambda: team.said(" is flown by m1") == 1, at_most=survey_times.AT_MOST)
    team.fake("m2.fc").set("sticks=true")
    team.run(0.3)
    team.crash("copter1")
    team.run(until_done=True, at_most=survey_times.AT_MOST)
    assert team.said("m2 is out, strip ") == 1
    assert team.said("m2.fc released") == 0
    assert team.fake("m2.fc").facts["mode"] == "POSCTL"


@pytest.mark.few(0)
@pytest.mark.parametrize("fault", ["silence", "motor_failure"])
def test_other_vehicles_fly_the_strip_of_a_failed_one(lfield_mission, tmp_path, fault):
    path = deployment(tmp_path, 2, SMALL)
    team = lfield_mission(path)
    victim, other = last_on_a_strip(team)
    team.fake(f"{victim}.fc").set(f"{fault}=true")
    finish(team, path, victim, other)


@pytest.mark.few(0)
def test_waiting_vehicle_flies_the_only_strip_of_a_failed_one(lfield_mission, tmp_path):
    path = deployment(tmp_path, 2, NARROW)
    team = lfield_mission(path)
    victim, other = last_on_a_strip(team)
    team.fake(f"{victim}.fc").set("motor_failure=true")
    finish(team, path, victim, other, strips=1)


@pytest.mark.few(0)
def test_four_vehicles_chosen_by_the_registry_share_the_field(lfield_mission, tmp_path):
    path = deployment(tmp_path, 4)
    team = lfield_mission(path)
    team.run(until_done=True, at_most=survey_times.AT_MOST)
    assert team.ended == {"survey": "done"}
    assert sorted(flown(team)) == list(range(9))
    assert set(flown(team).values()) == {"m1", "m2", "m3", "m4"}
    assert uncovered(team, path.with_name("field.kml")) == []
    assert row("4")[1:] == (9, 0)
    assert all(track[-1].up < 0.2 for track in team.tracks.values()), "all have landed"

"""Three tiers, on virtual time: `lfield test examples/16-three-tiers`."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from lfield.testing.mission.track_picture import draw

SITES = {"gate", "mast", "pump", "tank", "well", "yard"}
#: The obstacle, of which the planner has no data: metres north and east, and its radius.
OBSTACLE, RADIUS = (30.0, 12.0), 3.0
DRAWING = (Path(__file__).parent / "tracks.svg").read_text(encoding="utf-8")


def line_ends(svg):
    """Start and end of each line of a drawing, in units of 20 pixels."""
    lines = [re.findall(r"[0-9.]+", line) for line in re.findall(r'd="(M[^"]*)"', svg)]
    return [[round(float(number) / 20.0) for number in (*line[:2], *line[-2:])] for line in lines]


def inspections(team):
    """Vehicle and site of each inspection, in order."""
    return re.findall(r"^(\w+) inspects (\w+)$", "\n".join(line.text for line in team.log), re.MULTILINE)


def obstacle_distance(team):
    """The smallest distance of the rover from the obstacle, in metres."""
    return min(math.dist((point.north, point.east), OBSTACLE) for point in team.tracks["rover.fc"])


def are_home(team):
    """Whether both vehicles are at home, on the ground."""
    return all(math.hypot(*team.tracks[device][-1][1:]) < 2.0 for device in ("copter.fc", "rover.fc"))


def has_left_home(team, device):
    """Whether a device is farther than 8 m from home."""
    track = team.tracks[device]
    return bool(track) and math.hypot(track[-1].north, track[-1].east) > 8.0


@pytest.mark.few(0)
def test_copter_visits_the_site_that_the_rover_cannot_reach(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    assert team.ended == {"sequencer": "done"}
    assert sorted(site for _, site in inspections(team)) == sorted(SITES)
    assert ("copter", "mast") in inspections(team)
    assert team.said("rover did not come to mast: something is in the way") == 1
    assert RADIUS + 2.0 < obstacle_distance(team) < RADIUS + 9.0
    assert are_home(team)
    drawing = draw(team.tracks, "three tiers", team.marks)
    assert line_ends(drawing) == line_ends(DRAWING), "tracks.svg is outdated"
    # All hosts agree on the sensor data and the next step: before the first step, and after each step.
    hosts = {hop.target for hop in team.hops}
    agreements = 1 + sum(call.portal == "learn" for call in team.calls)
    assert (len(team.hops), agreements, len(hosts)) == (23, 6, 3)
    assert len(team.hops) < agreements * len(hosts) * (len(hosts) - 1) == 36


def test_tier_one_stops_for_obstacles_without_a_query(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until=lambda: has_left_home(team, "rover.fc"))
    for other in ("sky", "tower"):
        team.cut("ground", other)
    team.run(9.0)  # without the loop, the rover would reach the mast
    assert RADIUS + 2.0 < obstacle_distance(team) < RADIUS + 9.0
    for other in ("sky", "tower"):
        team.heal("ground", other)
    team.run(until="rover did not come to mast: something is in the way")
    assert obstacle_distance(team) > RADIUS + 2.0


@pytest.mark.few(0)
def test_tier_one_returns_on_low_battery_without_a_query(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until=lambda: has_left_home(team, "copter.fc"))
    calls = [call for call in team.calls if call.resource == "copter"]
    team.fake("copter.fc").set("battery=0.29")
    team.run(until="copter is home", at_most=40.0)
    assert calls == [call for call in team.calls if call.resource == "copter"]
    assert team.tracks["copter.fc"][-1].up < 0.1
    team.run(until_done=True)
    assert team.said("copter did not come to gate: its battery is low") == 1
    # The rover visits the copter's sites; no vehicle reaches the mast.
    assert sorted(inspections(team)) == [("rover", site) for site in sorted(SITES - {"mast"})]


@pytest.mark.few(0)
def test_battery_drained_by_wind_gives_a_new_plan(lfield_mission):
    team = lfield_mission("mission.dL", fakes={"copter.fc": ["wind=9", "wind_from=0.5"]})
    team.run(until="copter is home", at_most=100.0)
    lines = [line.text for line in team.log if "copter" in line.text]
    assert "sequencer: copter cannot go that far any more: " in lines[-3]
    assert lines[-2].endswith(" and shall visit nothing")
    assert ("copter", "mast") in inspections(team)
    assert team.tracks["copter.fc"][-1].up < 0.1


@pytest.mark.few(0)
@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("fails=MemoryError", "no plan: planner: it failed: MemoryError"),
        ("nonsense=repeated", "no plan: planner: its plan is invalid: it visits a site twice: [0, 0]"),
        ("slow=1e6", "no plan in time: "),
    ],
)
def test_old_plan_is_used_until_the_planner_answers_again(lfield_mission, fault, message):
    team = lfield_mission("mission.dL")
    team.run(until="rover can go")
    team.fake("strategist.planner").set(fault)
    team.run(until=message)
    team.fake("strategist.planner").set("fails=", "nonsense=", "slow=0")
    team.run(until="rover inspects pump")
    team.fake("rover.fc").set("battery=0.38")
    team.run(until="rover can go")
    assert team.said("rover can go") == 2


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("nonsense=unknown", "no plan: planner: its plan is invalid: there is no site 6"),
        ("nonsense=long", "no plan: planner: its plan is invalid: it is 177 m long, more than 84 m"),
        ("nonsense=42", "no plan: planner: its answer is invalid: '42'"),
    ],
)
def test_no_vehicle_moves_without_a_plan(lfield_mission, fault, message):
    team = lfield_mission("mission.dL", fakes={"strategist.planner": [fault]})
    team.run(until_done=True)
    assert team.ended == {"sequencer": "done"}
    assert team.said(message) == 1
    assert inspections(team) == []
    assert not team.has_moved


@pytest.mark.few(0)
def test_mission_waits_for_a_slow_planner(lfield_mission):
    team = lfield_mission("mission.dL", fakes={"strategist.planner": ["slow=4"]})
    team.run(until="rover can go")
    (plan,) = (call for call in team.calls if call.portal == "plan")
    assert 8.0 < plan.ended - plan.at < 10.0


def test_sequencing_coordinators_are_activated_and_deactivated(lfield_mission):
    team = lfield_mission("sequences.dL")
    team.type_line("tower", "yes")
    team.run(until_done=True)
    assert team.ended == {"director": "done", "survey": "done", "homing": "done"}
    assert [team.said(text) for text in ("survey leg", "landed", "homing is done")] == [2, 1, 1]


def test_no_coordinator_starts_without_the_operators_confirmation(lfield_mission):
    team = lfield_mission("sequences.dL")
    team.run(until_done=True)
    assert team.ended == {"director": "done"}
    assert team.said("nothing begins") == 1
    assert team.now > 30.0

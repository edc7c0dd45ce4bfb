"""Three rovers and a box, on virtual time: `lfield test examples/21-box-pushing`."""

from __future__ import annotations

import math

import pytest
import terrain_pushes

#: The goal of the box, and tolerances of its position in m and heading in rad.
GOAL, TOLERANCE, HEADING_TOLERANCE = (3.0, 1.0, 0.5), 0.05, 0.05


def final_pose(team):
    """The final pose of the box, as measured by a rover."""
    calls = [call for call in team.calls if call.portal in ("look", "driveTo") and call.result is not None]
    return calls[-1].result.target


def assert_box_at_goal(team):
    assert team.ended == {"movers": "done"}
    north, east, heading = final_pose(team)
    assert math.dist((north, east), GOAL[:2]) < TOLERANCE
    assert abs(heading - GOAL[2]) < HEADING_TOLERANCE


def test_box_reaches_its_goal_pose(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    assert_box_at_goal(team)
    assert math.dist(team.fake("box").place[:2], GOAL[:2]) < TOLERANCE, "the true position must agree"
    # A step needs 2(N-1) = 4 hops.
    steps = sum(call.portal == "driveTo" for call in team.calls) // 3
    assert 20 < steps < 30
    assert len(team.hops) <= 4 * steps + 1


@pytest.mark.few(0)
def test_all_rovers_drive_at_the_same_time_in_each_step(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    drives = [call for call in team.calls if call.portal == "driveTo"]
    for step in zip(*[iter(drives)] * 3, strict=True):
        assert max(call.at for call in step) < min(call.ended for call in step)


@pytest.mark.few(0)
@pytest.mark.parametrize("rover", ["left", "middle", "right"])
def test_box_arrives_with_a_weak_rover(lfield_mission, rover):
    team = lfield_mission("mission.dL", fakes={f"{rover}.wheels": ["weak=0.3"]})
    team.run(until_done=True)
    assert_box_at_goal(team)
    assert not team.said("pushes no more")


@pytest.mark.few(0)
@pytest.mark.parametrize("rover", ["left", "middle", "right"])
@pytest.mark.parametrize("fault", ["broken", "silent"])
def test_failed_rover_is_left_behind_and_two_continue(lfield_mission, rover, fault):
    team = lfield_mission("mission.dL")
    team.at(12.0, lambda: team.fake(f"{rover}.wheels").set(f"{fault}=true"))
    team.run(until_done=True)
    assert_box_at_goal(team)
    assert team.said(f"{rover} pushes no more") == 1
    assert math.dist(team.fake(f"{rover}.wheels").place[:2], GOAL[:2]) > 1.0


@pytest.mark.few(0)
def test_rover_with_a_lost_computer_stops_and_two_continue(lfield_mission):
    team = lfield_mission("mission.dL")
    team.at(12.0, lambda: team.crash("port"))
    team.run(14.0)
    stopped = team.fake("left.wheels").place
    team.run(until_done=True)
    assert_box_at_goal(team)
    assert team.said("left pushes no more: port could not be reached") == 1
    assert math.dist(team.fake("left.wheels").place, stopped) < 0.3  # only displaced by contact


def test_single_rover_stops_and_reports_the_position_of_the_box(lfield_mission):
    team = lfield_mission(
        "mission.dL", fakes={f"{rover}.wheels": ["broken=true"] for rover in ("left", "right")}
    )
    team.run(until_done=True)
    assert team.ended == {"movers": "done"}
    assert team.said("the box is at (0.00, 0.00)") == 1


def test_tracks_have_the_order_of_the_simulated_device(lfield_mission):
    """The order determines the colours of a drawing, so it must be the same in each process."""
    team = lfield_mission("mission.dL")
    team.run(0.5)
    names = [name for name in team.tracks if name.startswith("box")]
    assert names == ["box", "box, left end", "box, right end"]


@pytest.mark.few(0)
@pytest.mark.parametrize(
    ("world", "distance", "heading_error"),
    [("slope=0.03", 0.1, 0.3), ("mud=2", 0.05, 0.05), ("slope=-0.06", 0.1, 0.4)],
)
def test_box_is_pushed_over_terrain(world, distance, heading_error):
    """On a slope the box points uphill, because pushing robots exert no lateral force."""
    result = terrain_pushes.push(world)
    assert result.distance < distance
    assert result.heading_error < heading_error
    assert result.steps < 30


@pytest.mark.few(0)
def test_heavy_mud_stops_three_rovers():
    assert terrain_pushes.push("mud=3").distance > 1.0

"""Three rovers and a box, on virtual time: `lfield test examples/21-box-pushing`."""

from __future__ import annotations

import math

import pytest
import terrain_pushes

#: Goal of the box, and tolerances: metres and radians.
GOAL, NEAR, STRAIGHT = (3.0, 1.0, 0.5), 0.05, 0.05


def pose(team):
    """The final pose of the box, as a rover sees it."""
    calls = [call for call in team.calls if call.portal in ("look", "driveTo") and call.result is not None]
    return calls[-1].result.target


def arrived(team):
    assert team.ended == {"movers": "done"}
    north, east, heading = pose(team)
    assert math.dist((north, east), GOAL[:2]) < NEAR
    assert abs(heading - GOAL[2]) < STRAIGHT


def test_box_reaches_its_goal_pose(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    arrived(team)
    assert math.dist(team.fake("box").place[:2], GOAL[:2]) < NEAR, "the simulated plane agrees"
    # Two hops for each rover but one in a step; broadcasting would take N(N-1) = 6 messages.
    steps = sum(call.portal == "driveTo" for call in team.calls) // 3
    assert 20 < steps < 30
    assert len(team.hops) <= 4 * steps + 1


@pytest.mark.few(0)
def test_all_rovers_of_a_step_drive_at_the_same_time(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    drives = [call for call in team.calls if call.portal == "driveTo"]
    for step in zip(*[iter(drives)] * 3, strict=True):
        assert max(call.at for call in step) < min(call.ended for call in step)


@pytest.mark.few(0)
@pytest.mark.parametrize("who", ["left", "middle", "right"])
def test_weak_rover_is_compensated(lfield_mission, who):
    team = lfield_mission("mission.dL", fakes={f"{who}.wheels": ["weak=0.3"]})
    team.run(until_done=True)
    arrived(team)
    assert not team.said("pushes no more")


@pytest.mark.few(0)
@pytest.mark.parametrize("who", ["left", "middle", "right"])
@pytest.mark.parametrize("fault", ["broken", "silent"])
def test_failed_rover_is_left_behind_and_two_continue(lfield_mission, who, fault):
    team = lfield_mission("mission.dL")
    team.at(12.0, lambda: team.fake(f"{who}.wheels").set(f"{fault}=true"))
    team.run(until_done=True)
    arrived(team)
    assert team.said(f"{who} pushes no more") == 1
    assert math.dist(team.fake(f"{who}.wheels").place[:2], GOAL[:2]) > 1.0


def test_rover_without_its_computer_stops_and_two_continue(lfield_mission):
    team = lfield_mission("mission.dL")
    team.at(12.0, lambda: team.crash("port"))
    team.run(14.0)
    stood = team.fake("left.wheels").place
    team.run(until_done=True)
    arrived(team)
    assert team.said("left pushes no more: port could not be reached") == 1
    assert math.dist(team.fake("left.wheels").place, stood) < 0.3, "it was only displaced by contact"


def test_single_rover_gives_up_and_reports_the_position_of_the_box(lfield_mission):
    team = lfield_mission("mission.dL", fakes={f"{who}.wheels": ["broken=true"] for who in ("left", "right")})
    team.run(until_done=True)
    assert team.ended == {"movers": "done"}
    assert team.said("the box is at (0.00, 0.00)") == 1


def test_tracked_objects_keep_the_order_of_their_fake(lfield_mission):
    """Colours of a picture depend on it: the order of a set would differ between processes."""
    team = lfield_mission("mission.dL")
    team.run(0.5)
    assert [name for name in team.tracks if name.startswith("box")] == [
        "box",
        "box, left end",
        "box, right end",
    ]


@pytest.mark.few(0)
@pytest.mark.parametrize(
    ("world", "away", "turned"), [("slope=0.03", 0.1, 0.3), ("mud=2", 0.05, 0.05), ("slope=-0.06", 0.1, 0.4)]
)
def test_box_is_pushed_over_terrain(world, away, turned):
    """On a slope the box points uphill, since pushing robots exert no lateral force."""
    end = terrain_pushes.push(world)
    assert end.away < away
    assert end.turned < turned
    assert end.steps < 30


@pytest.mark.few(0)
def test_heavy_mud_stops_three_rovers():
    assert terrain_pushes.push("mud=3").away > 1.0

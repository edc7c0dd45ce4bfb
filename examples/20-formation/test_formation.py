"""The march on virtual time: `lfield test examples/20-formation`."""

from __future__ import annotations

import math
from itertools import combinations, permutations

import pytest
import terrain_marches

COPTERS, ROVERS = ("ada", "bob", "cat"), ("dan", "eve")
HOSTS = dict(zip((*COPTERS, *ROVERS), ("alpha", "bravo", "carol", "delta", "echo"), strict=True))
#: Metres: spacing of the slots; tolerance of a robot's position at the end of a leg.
SPACING, TOLERANCE = 4.0, 0.6
#: For each formation, the end of its leg, north and east in metres, and the heading there.
LEGS = {"wedge": (18.0, 0.0, 0.0), "column": (18.0, 18.0, math.pi / 2), "line": (0.0, 18.0, math.pi)}
#: Seconds since the start: in the middle of the second leg, that of the column.
SECOND_LEG = 38.0


def slots(formation, count):
    """The slots of a formation at the end of its leg, computed independently of the mission."""
    north, east, heading = LEGS[formation]
    if formation == "wedge":
        steps = [(-rank, side * rank) for rank, side in ((0, 0), (1, -1), (1, 1), (2, -1), (2, 1))]
        body = [(ahead * SPACING / math.sqrt(2), right * SPACING / math.sqrt(2)) for ahead, right in steps]
    else:
        body = [(-SPACING * i, 0.0) for i in range(count)]
    if formation == "line":
        body = [(0.0, SPACING * (i - (count - 1) / 2)) for i in range(count)]
    cos, sin = math.cos(heading), math.sin(heading)
    return [(north + a * cos - r * sin, east + a * sin + r * cos) for a, r in body[:count]]


def reported_size(team, formation):
    """The size of a formation at the end of its leg, and the time."""
    (line,) = [line for line in team.log if f"a {formation} of" in line.text]
    return int(line.text.split(" of ")[1].split()[0]), line.at


def position_at(team, robot, time):
    return min(team.tracks[f"{robot}.fc"], key=lambda point: abs(point.at - time))


def largest_error(team, formation, members=(*COPTERS, *ROVERS)):
    """The largest distance of a member from its slot at the end of the leg, in metres; for the best order."""
    count, time = reported_size(team, formation)
    assert count == len(members)
    positions = [position_at(team, robot, time)[1:3] for robot in members]
    return min(max(map(math.dist, positions, order)) for order in permutations(slots(formation, count)))


def smallest_distance(team, group):
    """The smallest distance between two members of a group during the run."""
    tracks = [team.tracks[f"{robot}.fc"] for robot in group]
    return min(math.dist(a[1:], b[1:]) for x, y in combinations(tracks, 2) for a, b in zip(x, y, strict=True))


def agreements(team):
    """The number of agreements: one for each step, and one for the landing."""
    return max(sum(call.resource == robot for call in team.calls) for robot in HOSTS)


def assert_column_stays_together(team):
    """In the second leg, the column is longer than its slots by at most one step."""
    start, end = reported_size(team, "wedge")[1] + 10.0, reported_size(team, "column")[1]
    for tenth in range(int(start * 10), int(end * 10)):
        column = sorted(position_at(team, robot, tenth / 10).east for robot in HOSTS)
        assert column[-1] - column[0] < 4 * SPACING + 6.0


def assert_simultaneous_steps(team):
    """All robots move at the same time; each step needs at most 2N - 2 = 8 hops."""
    moves = [call for call in team.calls if call.portal in ("flyTo", "driveTo")]
    steps = [moves[i : i + 5] for i in range(0, len(moves), 5)]
    assert len(steps) == agreements(team) - 1 == 12
    assert all(max(call.at for call in step) < min(call.ended for call in step) for step in steps)
    assert len(team.hops) <= 8 * 13


def run_march(lfield_mission, **options):
    team = lfield_mission("mission.dL", **options)
    team.run(until_done=True)
    assert team.ended == {"march": "done"}
    return team


def run_march_with_event(lfield_mission, cause_event, time=SECOND_LEG):
    """Run a march with an event in the second leg."""
    team = lfield_mission("mission.dL")
    team.at(time, lambda: cause_event(team))
    team.run(until_done=True, at_most=200.0)
    assert team.ended == {"march": "done"}
    assert largest_error(team, "wedge") < TOLERANCE
    assert reported_size(team, "wedge")[1] < time < reported_size(team, "column")[1]
    return team


@pytest.mark.few(0)
def test_every_formation_is_reached_without_a_collision(lfield_mission):
    team = run_march(lfield_mission)
    assert all(largest_error(team, formation) < TOLERANCE for formation in LEGS)
    assert smallest_distance(team, COPTERS) > SPACING - 0.5
    assert smallest_distance(team, ROVERS) > SPACING / 2
    assert 3.5 < max(point.up for point in team.tracks["ada.fc"]) < 4.5
    assert not any(team.fake(f"{copter}.fc").facts["airborne"] for copter in COPTERS)
    assert_column_stays_together(team)
    assert_simultaneous_steps(team)


@pytest.mark.few(0)
@pytest.mark.parametrize("failed", ["bob", "cat", "dan"])
def test_formation_closes_after_a_motor_failure(lfield_mission, failed):
    team = run_march_with_event(
        lfield_mission, lambda team: team.fake(f"{failed}.fc").set("motor_failure=true")
    )
    others = [robot for robot in HOSTS if robot != failed]
    assert team.said(f"march: {failed}.fc is left behind") == 1
    assert largest_error(team, "column", others) < TOLERANCE
    assert largest_error(team, "line", others) < TOLERANCE


@pytest.mark.few(0)
@pytest.mark.parametrize("group", [COPTERS, ROVERS])
def test_robot_with_a_lost_computer_is_left_behind(lfield_mission, group):
    lost = []

    def crash_one_host(team):
        # Another test crashes the host of the coordinator.
        lost.append(next(robot for robot in group if HOSTS[robot] != team.hops[-1].target))
        team.crash(HOSTS[lost[0]])

    team = run_march_with_event(lfield_mission, crash_one_host)
    others = [robot for robot in HOSTS if robot not in lost]
    assert team.said(f"march: {lost[0]} is left behind: {HOSTS[lost[0]]} could not be reached") == 1
    assert largest_error(team, "line", others) < TOLERANCE
    assert not team.fake(f"{lost[0]}.fc").facts["moving"], "the robot must be in its safe state"


@pytest.mark.few(0)
@pytest.mark.parametrize(
    ("time", "remaining"),
    [(SECOND_LEG, 2), (SECOND_LEG + 2.0, 3)],
    ids=["both-rovers-drive", "one-rover-drives"],
)
def test_march_continues_when_the_coordinators_host_is_lost(lfield_mission, time, remaining):
    lost = []

    def power_off_coordinators_host(team):
        lost.append(team.hops[-1].target)
        team.power_off(lost[0])

    team = run_march_with_event(lfield_mission, power_off_coordinators_host, time)
    assert team.said("march recovered on this host") == 1
    (failed,) = (robot for robot, host in HOSTS.items() if host == lost[0])
    assert team.said(f"march: {failed} is left behind") == 1
    # Robots that move when the failed coordinator is fenced enter their safe states.
    held = {
        robot
        for robot in HOSTS
        if team.said(f"{robot}.fc entering safe state 'hold': march, which has used it")
    }
    for robot in held:
        assert team.said(f"march: {robot}.fc is left behind: fc: held in its safe state") == 1
    others = [robot for robot in HOSTS if robot != failed and robot not in held]
    assert len(others) == remaining
    assert largest_error(team, "line", others) < TOLERANCE


@pytest.mark.few(0)
def test_two_robots_that_fail_at_the_same_time_are_left_behind(lfield_mission):
    def stop_motor_and_disconnect_host(team):
        team.fake("bob.fc").set("motor_failure=true")
        for host in ("alpha", "bravo", "carol", "delta"):
            team.cut("echo", host)

    team = run_march_with_event(lfield_mission, stop_motor_and_disconnect_host)
    assert team.said("is left behind") == 2
    assert largest_error(team, "line", ["ada", "cat", "dan"]) < TOLERANCE


@pytest.mark.few(0)
def test_formation_holds_in_wind_and_gusts(lfield_mission):
    wind = ["wind=7", "gusts=4", "wind_from=0.8"]
    team = run_march(lfield_mission, fakes={f"{copter}.fc": wind for copter in COPTERS})
    assert all(largest_error(team, formation) < TOLERANCE for formation in LEGS)


@pytest.mark.few(0)
def test_copter_that_a_storm_blows_away_is_left_behind(lfield_mission):
    team = run_march_with_event(lfield_mission, lambda team: team.fake("ada.fc").set("wind=20"))
    assert team.said("march: ada.fc is left behind") == 1
    assert largest_error(team, "line", ["bob", "cat", "dan", "eve"]) < TOLERANCE


@pytest.mark.few(0)
def test_copter_with_a_low_battery_does_not_start(lfield_mission):
    team = run_march(lfield_mission, fakes={"bob.fc": ["battery=0.25"]})
    assert largest_error(team, "line", [robot for robot in HOSTS if robot != "bob"]) < TOLERANCE
    assert not any(point.up > 0.1 for point in team.tracks["bob.fc"])


@pytest.mark.few(0)
def test_same_seed_gives_the_same_march(lfield_mission):
    first, second = (run_march(lfield_mission, seed=1) for _ in range(2))
    assert first.tracks == second.tracks
    assert first.log == second.log


@pytest.mark.few(0)
@pytest.mark.parametrize("terrain", [terrain_marches.mud, terrain_marches.hill, terrain_marches.valley])
def test_formation_holds_over_terrain(terrain):
    result = terrain_marches.march(terrain)
    assert result.arrived == 5
    assert result.spread < 2.5 * SPACING

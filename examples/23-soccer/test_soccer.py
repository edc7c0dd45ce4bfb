"""Two teams of three and a ball, on virtual time: `lfield test examples/23-soccer`."""

from __future__ import annotations

import math
import re
from itertools import pairwise

import league
import pytest

#: Metres: distances of goal lines, side walls and posts from the centre; radii of the ball and of a robot.
LINE, SIDE, POST, BALL, ROBOT = 2.0, 1.5, 0.5, 0.06, 0.15
#: The player on each host of the red team.
PLAYERS = {"red1": "ann", "red2": "bob", "red3": "cid"}


def true_score(team):
    """The goals of red, in the north, and of blue, in the south, from the track of the ball."""
    norths = [point.north for point in team.tracks["ball"]]
    goals = [now for before, now in pairwise(norths) if abs(before) <= LINE + BALL < abs(now)]
    return sum(north > 0.0 for north in goals), sum(north < 0.0 for north in goals)


def reported_score(team, coach):
    """The score that a coach reports, with the goals of its team first."""
    pattern = re.compile(rf"{coach}: (\d+):(\d+) after \d+ rounds and ")
    (match,) = filter(None, (pattern.match(line.text) for line in team.log))
    return int(match[1]), int(match[2])


def distance_travelled(team, player, start, end):
    """The distance in metres that a player has travelled between two times."""
    points = [point for point in team.tracks[f"{player}.wheels"] if start <= point.at <= end]
    return sum(math.dist((a.north, a.east), (b.north, b.east)) for a, b in pairwise(points))


@pytest.mark.few(0)
@pytest.mark.parametrize("seed", [0, 2, 4])
def test_both_coaches_count_the_goals(lfield_mission, seed):
    team = lfield_mission("mission.dL", seed=seed)
    team.run(until_done=True)
    assert team.ended == {"red": "done", "blue": "done"}
    assert sum(true_score(team)) > 0
    assert reported_score(team, "red") == true_score(team)
    assert reported_score(team, "blue") == true_score(team)[::-1]
    # A round needs at most N = 3 hops.
    rounds = sum(call.resource in PLAYERS.values() for call in team.calls) / 3
    assert sum(hop.agent == "red" for hop in team.hops) <= 3 * rounds


@pytest.mark.few(0)
def test_same_seed_gives_the_same_match(lfield_mission):
    matches = []
    for seed in (1, 1, 2):
        team = lfield_mission("mission.dL", seed=seed)
        team.run(12.0)
        matches.append((team.tracks, team.hops, team.log))
    assert matches[0] == matches[1]
    assert matches[0] != matches[2]


@pytest.mark.few(0)
def test_two_players_continue_after_a_failure_of_the_third(lfield_mission):
    team = lfield_mission("mission.dL", seed=1)
    team.at(8.0, lambda: team.fake("cid.wheels").set("broken=true"))
    team.run(25.0)
    assert team.said("cid does not play: ") > 0
    others = min(distance_travelled(team, player, 10.0, 25.0) for player in ("ann", "bob"))
    assert others > 2.0 * distance_travelled(team, "cid", 10.0, 25.0), "cid must only be displaced by contact"
    orders = [call for call in team.calls if call.at > 10.0 and call.resource in PLAYERS.values()]
    attackers = {call.resource for call in orders if call.arguments[0]}
    assert attackers
    assert "cid" not in attackers


@pytest.mark.few(0)
def test_repaired_robot_plays_again(lfield_mission):
    team = lfield_mission("mission.dL", seed=1)
    team.at(5.0, lambda: team.fake("cid.wheels").set("broken=true"))
    team.at(10.0, lambda: team.fake("cid.wheels").set("broken=false"))
    team.run(25.0)
    assert distance_travelled(team, "cid", 15.0, 25.0) > 1.0


@pytest.mark.few(0)
def test_team_plays_without_its_coach_until_recovery(lfield_mission):
    team, killed = lfield_mission("mission.dL", seed=1), []

    def kill_coachs_host():
        killed.append([hop for hop in team.hops if hop.agent == "red"][-1].target)
        team.power_off(killed[0])

    team.at(8.0, kill_coachs_host)
    team.run(until="recovered on this host")
    recovered, others = team.now, [player for host, player in PLAYERS.items() if host != killed[0]]
    assert sum(distance_travelled(team, player, 8.0, recovered) for player in others) > 0.5
    team.run(until_done=True)
    assert team.ended == {"red": "done", "blue": "done"}
    assert reported_score(team, "red") == true_score(team)
    assert reported_score(team, "blue") == true_score(team)[::-1]
    assert {call.resource for call in team.calls if call.at > recovered and call.result} >= set(others)


@pytest.mark.few(0)
def test_ball_leaves_the_pitch_between_the_posts_and_robots_do_not(lfield_mission):
    """Runs until the first goal. `-k posts --tracks DIR` draws the picture of README.md."""
    team = lfield_mission("mission.dL", seed=3)
    team.run(until=lambda: abs(team.fake("ball").place[0]) > LINE + BALL)
    assert abs(team.fake("ball").place[1]) < POST - BALL + 0.01
    robots = [point for name, points in team.tracks.items() if name != "ball" for point in points]
    assert max(abs(point.north) for point in robots) < LINE - ROBOT + 0.01
    assert max(abs(point.east) for point in robots) < SIDE - ROBOT + 0.01


@pytest.mark.few(0)
@pytest.mark.process
def test_two_missions_meet_at_the_referee():
    """Two missions run as processes in real time, start together, and get the same score from the referee."""
    red, blue = league.match(8.0)
    assert (red.north, red.south) == (blue.north, blue.south)
    assert min(red.hops, blue.hops) > 8


@pytest.mark.few(0)
def test_match_does_not_start_without_the_other_team(lfield_mission):
    team = lfield_mission("red.dL")
    team.run(30.0)
    assert team.said("kick-off") == 0
    assert max(distance_travelled(team, player, 0.0, 30.0) for player in PLAYERS.values()) < 0.01
    team.run(until_done=True)
    assert team.said("there is no other team") == 1

"""Two teams of three and a ball, on virtual time: `lfield test examples/23-soccer`."""

from __future__ import annotations

import math
import re
from itertools import pairwise

import league
import pytest

#: Metres: goal lines, side walls and posts from the middle; radii of the ball and of a robot.
LINE, SIDE, POST, BALL, ROBOT = 2.0, 1.5, 0.5, 0.06, 0.15
HOSTS = {"red1": "ann", "red2": "bob", "red3": "cid"}


def goals(team):
    """Goals seen at the lines: for the reds, in the north, and for the blues."""
    norths = [point.north for point in team.tracks["ball"]]
    went = [now for before, now in pairwise(norths) if abs(before) <= LINE + BALL < abs(now)]
    return sum(north > 0.0 for north in went), sum(north < 0.0 for north in went)


def reported_score(team, who):
    """The score as a coach reports it, its own goals first."""
    (line,) = [
        line.text for line in team.log if line.text.startswith(f"{who}: ") and " rounds and " in line.text
    ]
    ours, theirs = re.search(r"(\d+):(\d+)", line).groups()
    return int(ours), int(theirs)


def way(team, who, since, until):
    """The distance of a robot in that time, in metres."""
    there = [point for point in team.tracks[f"{who}.wheels"] if since <= point.at <= until]
    return sum(math.dist((a.north, a.east), (b.north, b.east)) for a, b in pairwise(there))


@pytest.mark.few(0)
@pytest.mark.parametrize("seed", [0, 2, 4])
def test_both_coaches_count_the_goals(lfield_mission, seed):
    team = lfield_mission("mission.dL", seed=seed)
    team.run(until_done=True)
    assert team.ended == {"red": "done", "blue": "done"}
    assert sum(goals(team)) > 0
    assert reported_score(team, "red") == goals(team)
    assert reported_score(team, "blue") == goals(team)[::-1]
    # One round is N hops; broadcasting would take N(N-1) = 6 messages.
    rounds = len([call for call in team.calls if call.resource in HOSTS.values()]) / 3
    assert len([hop for hop in team.hops if hop.agent == "red"]) <= 3 * rounds


@pytest.mark.few(0)
def test_same_seed_gives_the_same_match(lfield_mission):
    matches = []
    for seed in (1, 1, 2):
        team = lfield_mission("mission.dL", seed=seed)
        team.run(12.0)
        matches.append((team.tracks, team.hops, team.log))
    assert matches[0] == matches[1]
    assert matches[0] != matches[2]


def test_failed_robot_leaves_two_to_play(lfield_mission):
    team = lfield_mission("mission.dL", seed=1)
    team.at(8.0, lambda: team.fake("cid.wheels").set("broken=true"))
    team.run(25.0)
    assert team.said("cid does not play: ") > 0
    others = min(way(team, who, 10.0, 25.0) for who in ("ann", "bob"))
    assert others > 2.0 * way(team, "cid", 10.0, 25.0), "it is only displaced by contact"
    orders = [call for call in team.calls if call.at > 10.0 and call.resource in HOSTS.values()]
    attack = [call.resource for call in orders if call.arguments[0]]
    assert "cid" not in attack
    assert attack


@pytest.mark.few(0)
def test_repaired_robot_plays_again(lfield_mission):
    team = lfield_mission("mission.dL", seed=1)
    team.at(5.0, lambda: team.fake("cid.wheels").set("broken=true"))
    team.at(10.0, lambda: team.fake("cid.wheels").set("broken=false"))
    team.run(25.0)
    assert way(team, "cid", 15.0, 25.0) > 1.0


@pytest.mark.few(0)
def test_team_plays_without_its_coach_until_recovery(lfield_mission):
    team, killed = lfield_mission("mission.dL", seed=1), []

    def kill():
        # The coach's last destination.
        killed.append([hop for hop in team.hops if hop.agent == "red"][-1].target)
        team.power_off(killed[0])

    team.at(8.0, kill)
    team.run(until="recovered on this host")
    back, left = team.now, [who for host, who in HOSTS.items() if host != killed[0]]
    assert sum(way(team, who, 8.0, back) for who in left) > 0.5, "the robots continue without new commands"
    team.run(until_done=True)
    assert team.ended == {"red": "done", "blue": "done"}
    assert reported_score(team, "red") == goals(team)
    assert reported_score(team, "blue") == goals(team)[::-1]
    assert {call.resource for call in team.calls if call.at > back and call.result} >= set(left)


@pytest.mark.few(0)
def test_ball_leaves_between_the_posts_and_robots_stay(lfield_mission):
    """From the kick-off to the first goal: with `-k posts --tracks DIR` the picture of the README."""
    team = lfield_mission("mission.dL", seed=3)
    team.run(until=lambda: abs(team.fake("ball").place[0]) > LINE + BALL)
    assert abs(team.fake("ball").place[1]) < POST - BALL + 0.01
    robots = [point for name, points in team.tracks.items() if name != "ball" for point in points]
    assert max(abs(point.north) for point in robots) < LINE - ROBOT + 0.01
    assert max(abs(point.east) for point in robots) < SIDE - ROBOT + 0.01


@pytest.mark.few(0)
@pytest.mark.process
def test_two_missions_meet_at_the_referee():
    """Two missions as processes, in real time: they start together, and the referee gives both its score."""
    red, blue = league.match(8.0)
    assert (red.north, red.south) == (blue.north, blue.south)
    assert min(red.hops, blue.hops) > 8


@pytest.mark.few(0)
def test_match_does_not_begin_without_the_other_team(lfield_mission):
    team = lfield_mission("red.dL")
    team.run(30.0)
    assert team.said("kick-off") == 0
    assert max(way(team, who, 0.0, 30.0) for who in ("ann", "bob", "cid")) < 0.01
    team.run(until_done=True)
    assert team.said("there is no other team") == 1

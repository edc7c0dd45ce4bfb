"""Two copters carry a beam, on virtual time: `lfield test examples/05-two-carry-one`."""

from __future__ import annotations

import math
import re
from itertools import combinations, pairwise
from pathlib import Path

import flown
import pytest

HERE = Path(__file__).parent
COPTERS = {"ada": "alpha", "bob": "bravo", "cat": "carol", "dan": "delta"}
#: Metres: length of the beam, and tolerance of the distance and height of its carriers.
LENGTH, OFF = 4.0, 0.6
#: The goal of the beam's middle, north and east.
GOAL = (16.0, 0.0)


def landed(team, who):
    return not team.fake(f"{who}.fc").facts["airborne"]


def at_home(team, who):
    track = team.tracks[f"{who}.fc"]
    return math.dist(track[0][1:3], track[-1][1:3]) < 1.0 and landed(team, who)


def carriers(team):
    """The pairs that were asked to carry the beam, in order."""
    lines = [line.text for line in team.log if "take the beam" in line.text]
    return [re.match(r"beam: (\w+)\+(\w+) take", text).groups() for text in lines]


def bears(team, start, end, pair):
    """The carriers keep the beam's length as distance, and the same height."""
    west, east = (team.tracks[f"{who}.fc"] for who in pair)
    apart = [
        (math.dist(a[1:3], b[1:3]), abs(a.up - b.up))
        for a, b in zip(west, east, strict=True)
        if start < a.at < end
    ]
    assert apart
    assert all(abs(far - LENGTH) < OFF and higher < 2.5 for far, higher in apart)


def lies(team):
    """The place of the beam's middle after it was put down, from the true positions of the vehicles."""
    west, east = list(flown.carried(team))[-1]
    assert max(west.up, east.up) < flown.LOW
    return (west.north + east.north) / 2, (west.east + east.east) / 2


def shows(svg):
    """The lines of a picture, with start and end, to 20 pixels."""
    lines = [re.findall(r"[0-9.]+", line) for line in re.findall(r'd="(M[^"]*)"', svg)]
    return [[round(float(number) / 20.0) for number in (*line[:2], *line[-2:])] for line in lines]


def carried_on(team):
    """After any failure the beam is at its goal, and the others are on the ground at home."""
    assert team.ended["beam"] == "done"
    assert math.dist(lies(team), GOAL) < OFF


def test_two_copters_carry_the_beam_and_two_the_crates(lfield_mission):
    team = flown.shown(lfield_mission("mission.dL"), fails=False)
    assert team.ended == {"beam": "done", "crates": "done"}
    assert carriers(team) == [("ada", "bob")]
    steps = flown.pairs(team)
    for one, other in steps:
        assert max(one.at, other.at) < min(one.ended, other.ended), "both at the same time"
    for step, following in pairwise(steps):
        assert max(call.ended for call in step) < min(call.at for call in following), "in step"
    low = [step[0].ended for step in steps if flown.down(step)]
    bears(team, *low, ("ada", "bob"))
    carried_on(team)
    assert all(at_home(team, who) for who in COPTERS)
    tracks = [team.tracks[f"{who}.fc"] for who in COPTERS]
    near = min(math.dist(a[1:], b[1:]) for x, y in combinations(tracks, 2) for a, b in zip(x, y, strict=True))
    assert near > LENGTH - OFF, "the carriers keep their distance"
    assert shows(flown.draw(team)) == shows((HERE / "tracks.svg").read_text()), "run flown.py"


@pytest.mark.few(0)
def test_second_mission_gets_the_next_best_team(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until="bring a crate each")
    assert team.said("crates: another team: ada is reserved by beam for ") == 1
    assert team.said("crates: cat and dan bring a crate each") == 1


@pytest.mark.few(0)
def test_crates_wait_for_the_carriers_when_no_team_is_left(lfield_mission):
    team = lfield_mission("mission.dL", fakes={"dan.fc": ["battery=0.2"]})
    team.run(until="bring a crate each")
    assert team.ended == {"beam": "done"}
    team.run(1.0)
    crew = {call.resource for call in team.calls if call.caller == "crates"}
    assert len(crew) == 2
    assert "dan" not in crew


@pytest.mark.few(0)
def test_motor_failure_makes_the_other_carrier_put_the_beam_down(lfield_mission):
    team = flown.shown(lfield_mission("mission.dL"), fails=True)
    assert team.said("beam: bob.fc has failed: fc: goTo ended early: it sinks at ") == 1
    failed = next(call for call in team.calls if call.thrown)
    by_ada = [call for call in team.calls if call.resource == "ada"]
    down = next(call for call in by_ada if call.at > failed.ended)
    last = by_ada[by_ada.index(down) - 1]
    assert last.arguments[:2] == down.arguments[:2], "at its present position"
    assert down.arguments[2] == -flown.ROPE
    assert not any(call.resource == "bob" and call.at > failed.ended for call in team.calls), (
        "bob gets no further command"
    )
    assert carriers(team) == [("ada", "bob"), ("ada", "cat")]
    carried_on(team)
    assert all(at_home(team, who) for who in COPTERS if who != "bob")
    assert shows(flown.draw(team)) == shows((HERE / "failed.svg").read_text()), "run flown.py"


@pytest.mark.few(0)
@pytest.mark.parametrize("aboard", [False, True], ids=["elsewhere", "aboard"])
def test_beam_is_delivered_when_a_computer_is_lost(lfield_mission, aboard):
    team = lfield_mission("mission.dL")
    team.run(until=lambda: team.now > 29.0)
    here = [hop.target for hop in team.hops if hop.agent == "beam"][-1]
    lost, left = ("ada", "bob") if (COPTERS["ada"] == here) == aboard else ("bob", "ada")
    team.crash(COPTERS[lost])
    team.run(until_done=True)
    assert landed(team, lost), "its end is down too: landing is its safe state"
    assert carriers(team)[0] == ("ada", "bob")
    assert len(carriers(team)) == 2
    assert lost not in carriers(team)[1]
    assert landed(team, left)
    carried_on(team)

"""Two copters carry a beam, on virtual time: `lfield test examples/05-two-carry-one`."""

from __future__ import annotations

import math
import re
from itertools import combinations, pairwise
from pathlib import Path

import draw_tracks
import pytest

HERE = Path(__file__).parent
COPTERS = {"ada": "alpha", "bob": "bravo", "cat": "carol", "dan": "delta"}
#: Metres: length of the beam; tolerance of positions and of the carriers' distance; of their heights.
LENGTH, TOLERANCE, HEIGHT_TOLERANCE = 4.0, 0.6, 2.5
#: The goal of the beam's centre, metres north and east.
GOAL = (16.0, 0.0)


def has_landed(team, copter):
    return not team.fake(f"{copter}.fc").facts["airborne"]


def is_home(team, copter):
    track = team.tracks[f"{copter}.fc"]
    return math.dist(track[0][1:3], track[-1][1:3]) < 1.0 and has_landed(team, copter)


def carriers(team):
    """The pairs of copters that have carried the beam, in order."""
    lines = [line.text for line in team.log if "take the beam" in line.text]
    return [re.match(r"beam: (\w+)\+(\w+) take", text).groups() for text in lines]


def assert_carriers_keep_distance(team, start, end, pair):
    """From start to end, the carriers' horizontal distance is the beam's length, at about the same height."""
    tracks = (team.tracks[f"{copter}.fc"] for copter in pair)
    points = [(a, b) for a, b in zip(*tracks, strict=True) if start < a.at < end]
    assert points
    assert all(abs(math.dist(a[1:3], b[1:3]) - LENGTH) < TOLERANCE for a, b in points)
    assert all(abs(a.up - b.up) < HEIGHT_TOLERANCE for a, b in points)


def beam_position(team):
    """The final position of the beam's centre, from the true positions of the carriers."""
    west, east = list(draw_tracks.carrier_positions(team))[-1]
    assert max(west.up, east.up) < draw_tracks.LOW
    return (west.north + east.north) / 2, (west.east + east.east) / 2


def line_ends(svg):
    """Start and end of each line of a drawing, in units of 20 pixels."""
    lines = [re.findall(r"[0-9.]+", line) for line in re.findall(r'd="(M[^"]*)"', svg)]
    return [[round(float(number) / 20.0) for number in (*line[:2], *line[-2:])] for line in lines]


def assert_beam_delivered(team):
    assert team.ended["beam"] == "done"
    assert math.dist(beam_position(team), GOAL) < TOLERANCE


@pytest.mark.few(0)
def test_two_copters_carry_the_beam_and_two_the_crates(lfield_mission):
    team = lfield_mission("mission.dL")
    draw_tracks.run_mission(team, bob_fails=False)
    assert team.ended == {"beam": "done", "crates": "done"}
    assert carriers(team) == [("ada", "bob")]
    steps = draw_tracks.carrier_steps(team)
    for first, second in steps:
        assert max(first.at, second.at) < min(first.ended, second.ended), (
            "both carriers must fly at the same time"
        )
    for step, following in pairwise(steps):
        assert max(call.ended for call in step) < min(call.at for call in following), "steps must not overlap"
    picked_up, put_down = (step[0].ended for step in steps if draw_tracks.is_at_load(step))
    assert_carriers_keep_distance(team, picked_up, put_down, ("ada", "bob"))
    assert_beam_delivered(team)
    assert all(is_home(team, copter) for copter in COPTERS)
    pairs = combinations([team.tracks[f"{copter}.fc"] for copter in COPTERS], 2)
    closest = min(
        math.dist(a[1:], b[1:]) for first, second in pairs for a, b in zip(first, second, strict=True)
    )
    assert closest > LENGTH - TOLERANCE, "the copters must keep their distance"
    drawing = (HERE / "tracks.svg").read_text()
    assert line_ends(draw_tracks.draw(team)) == line_ends(drawing), (
        "tracks.svg is outdated: run draw_tracks.py"
    )


def test_second_coordinator_gets_the_next_best_team(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until="bring a crate each")
    assert team.said("crates: another team: ada is reserved by beam for ") == 1
    assert team.said("crates: cat and dan bring a crate each") == 1


@pytest.mark.few(0)
def test_crates_wait_until_the_carriers_of_the_beam_are_free(lfield_mission):
    team = lfield_mission("mission.dL", fakes={"dan.fc": ["battery=0.2"]})
    team.run(until="bring a crate each")
    assert team.ended == {"beam": "done"}
    team.run(1.0)
    carriers_of_crates = {call.resource for call in team.calls if call.caller == "crates"}
    assert len(carriers_of_crates) == 2
    assert "dan" not in carriers_of_crates


@pytest.mark.few(0)
def test_other_carrier_puts_the_beam_down_after_a_motor_failure(lfield_mission):
    team = lfield_mission("mission.dL")
    draw_tracks.run_mission(team, bob_fails=True)
    assert team.said("beam: bob.fc has failed: fc: goTo ended early: it sinks at ") == 1
    failed = next(call for call in team.calls if call.thrown)
    ada_calls = [call for call in team.calls if call.resource == "ada"]
    descent = next(call for call in ada_calls if call.at > failed.ended)
    previous = ada_calls[ada_calls.index(descent) - 1]
    assert descent.arguments == (*previous.arguments[:2], -draw_tracks.HOOK_HEIGHT), "ada must stay there"
    assert not any(call.resource == "bob" and call.at > failed.ended for call in team.calls), (
        "bob must get no further command"
    )
    assert carriers(team) == [("ada", "bob"), ("ada", "cat")]
    assert_beam_delivered(team)
    assert all(is_home(team, copter) for copter in COPTERS if copter != "bob")
    drawing = (HERE / "failed.svg").read_text()
    assert line_ends(draw_tracks.draw(team)) == line_ends(drawing), (
        "failed.svg is outdated: run draw_tracks.py"
    )


@pytest.mark.few(0)
@pytest.mark.parametrize("with_pilot", [False, True], ids=["without-pilot", "with-pilot"])
def test_beam_is_delivered_when_a_carriers_computer_is_lost(lfield_mission, with_pilot):
    team = lfield_mission("mission.dL")
    team.run(until=lambda: team.now > 29.0)
    pilot_host = [hop.target for hop in team.hops if hop.agent == "beam"][-1]
    lost, other = ("ada", "bob") if (COPTERS["ada"] == pilot_host) == with_pilot else ("bob", "ada")
    team.crash(COPTERS[lost])
    team.run(until_done=True)
    assert has_landed(team, lost), "the copter must land, because landing is its safe state"
    assert carriers(team)[0] == ("ada", "bob")
    assert len(carriers(team)) == 2
    assert lost not in carriers(team)[1]
    assert has_landed(team, other)
    assert_beam_delivered(team)

"""Three tiers, on virtual time: `lfield test examples/16-three-tiers`."""

from __future__ import annotations

import math

import pytest

SITES = {"gate", "mast", "pump", "tank", "well", "yard"}
#: Where what nobody told the planner of stands: metres north and east, and its radius.
OBSTACLE, RADIUS = (30.0, 12.0), 3.0


def inspected(team):
    """Who has inspected what, in order."""
    words = (line.text.split() for line in team.log)
    return [(said[0], said[2]) for said in words if said[1:2] == ["inspects"]]


def nearest(team, device="rover.fc"):
    """How near a device came to the obstacle, in metres."""
    return min(math.dist((point.north, point.east), OBSTACLE) for point in team.tracks[device])


def at_home(team):
    """Whether both are back, the copter on the ground."""
    ends = [track[-1] for name, track in team.tracks.items() if name.endswith(".fc")]
    return len(ends) == 2 and all(math.hypot(*end[1:]) < 2.0 for end in ends)


def test_what_the_rover_cannot_come_to_the_copter_takes(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    assert team.ended == {"sequencer": "done"}
    done = inspected(team)
    assert {site for _, site in done} == SITES
    assert len(done) == len(SITES)
    assert ("copter", "mast") in done
    assert team.said("rover did not come to mast: something is in the way") == 1
    assert RADIUS + 2.0 < nearest(team) < RADIUS + 6.5
    assert at_home(team)
    # All hosts agree on what was sensed and what is next: once before the first step, and after each.
    hosts = {hop.target for hop in team.hops}
    agreements = 1 + sum(call.portal == "learn" for call in team.calls)
    assert (len(team.hops), agreements, len(hosts)) == (23, 6, 3)
    assert len(team.hops) < agreements * len(hosts) * (len(hosts) - 1) == 36


def test_tier_one_stops_for_what_is_in_the_way_without_asking_anybody(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until="rover can go")
    team.cut("ground", "tower")
    team.cut("ground", "sky")
    team.run(until=lambda: any(call.resource == "rover" for call in team.calls), at_most=60)

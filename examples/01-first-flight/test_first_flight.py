"""First flight, on virtual time: `lfield test examples/01-first-flight`."""

from __future__ import annotations

import math

import pytest


def test_copters_fly_mirrored_legs_at_a_safe_distance(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    assert team.ended == {"pilot": "done"}
    legs = [call for call in team.calls if call.portal == "fly"]
    assert [(call.resource, call.arguments[2]) for call in legs] == [("lead", 2.0), ("wing", 3.5)] * 3
    for lead, wing in zip(legs[::2], legs[1::2], strict=True):
        assert lead.arguments[:2] == tuple(-part for part in wing.arguments[:2])
        assert lead.at < wing.at < lead.ended, "the copters must fly at the same time"
    # Each of the five steps (takeoff, three legs, landing) needs two hops: one to start the second call, one
    # to fetch the first result. The summary needs one more, to the other copter.
    assert len(team.hops) == 11
    lead, wing = (team.tracks[name] for name in ("lead.fc", "wing.fc"))
    # Both copters take off at the same point; there, only their heights differ.
    in_flight = [(a, b) for a, b in zip(lead, wing, strict=True) if legs[0].at < a.at < legs[-1].ended]
    assert min(math.dist(a[1:], b[1:]) for a, b in in_flight) > 1.1
    assert lead[-1].up < 0.05
    assert wing[-1].up < 0.05


def test_failure_of_one_copter_lands_the_other(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until=lambda: any(call.portal == "fly" for call in team.calls))
    team.run(1.0)
    team.fake("lead.fc").set("motor_failure=true")
    team.run(until_done=True)
    assert team.ended == {"pilot": "done"}
    assert team.said("pilot: cutting the flight short: fc: ")
    assert len([call for call in team.calls if call.portal == "fly"]) == 2
    assert team.said("wing: landed", "bravo") == 1
    assert team.fake("wing.fc").facts["airborne"] is False


@pytest.mark.few(0)
def test_low_battery_gives_shorter_legs(lfield_mission):
    northmost = {}
    for charge in ("1.0", "0.45"):
        team = lfield_mission("mission.dL", fakes={"wing.fc": [f"battery={charge}"]})
        team.run(until_done=True)
        northmost[charge] = max(point.north for point in team.tracks["lead.fc"])
    assert 3.5 < northmost["1.0"] < 4.5
    assert 2.0 < northmost["0.45"] < 3.0


@pytest.mark.few(0)
def test_mission_completes_after_a_link_outage_in_flight(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until="lead: at")
    team.cut("alpha", "bravo")
    team.run(4.0)
    team.heal("alpha", "bravo")
    team.run(until_done=True)
    assert team.ended == {"pilot": "done"}
    assert [call.portal for call in team.calls].count("fly") == 6

"""The runs of demo.py, on virtual time: `lfield test examples/02-equivalent-lift`."""

from __future__ import annotations

import re

import demo
import pytest

#: Seconds after which every host has detected a fault.
NOTICED = 8.0
#: Each run includes the failures of the previous ones.
FAILURES = [(device, fault) for device, fault, _ in demo.FAILURES[1:]]


def run(lfield_mission, failures):
    """Run the mission with failures of these robots once the hook is down; returns the team."""
    team = lfield_mission("mission.dL")
    team.crash(demo.CART)
    team.run(until="the parcel is coming")
    for device, fault in failures:
        team.fake(device).set(fault)
    team.run(NOTICED)
    team.boot(demo.CART)
    team.run(until_done=True)
    assert team.ended == {"foreman": "done"}
    return team


def lifts(team):
    """The foreman's host when the parcel was up, and its height in metres."""
    found = [(line.host, re.match(r"foreman: the parcel went up by (.*) m$", line.text)) for line in team.log]
    return [(host, match[1]) for host, match in found if match]


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("count", "lift", "way"),
    [
        (0, ("yard", "0.8"), "crane shall lift (direct, "),
        (1, ("air", None), "equivalent: climb-lifts of Climb"),
        (2, ("bench", "0.8"), "composed: grip-and-climb of Grip (hand), Climb (arm)"),
        (3, None, "no agent can lift the parcel"),
    ],
)
def test_best_then_equivalent_then_composed_lift_then_none(lfield_mission, count, lift, way):
    team = run(lfield_mission, FAILURES[:count])
    assert team.said(way)
    found = lifts(team)
    if lift is None:
        assert found == []
        for why in ("crane: axis: no message", "sky: battery 0.15 (measured ", "hand: motor: no message"):
            assert team.said(why)
        return
    ((host, height),) = found
    assert host == lift[0]
    # The crane and the arm are exact; a copter is not.
    assert height == lift[1] or (lift[1] is None and abs(float(height) - 0.8) < 0.3)


def test_demonstration_detects_the_wrong_robot():
    up, stale = "foreman: the parcel went up by 0.8 m\n", "foreman: crane could not: it is lost\n"
    crane, sky = "foreman: crane shall lift (direct)\n", "foreman: sky shall lift (equivalent)\n"
    assert demo.wrong([crane, up], "crane") == ""
    assert demo.wrong([crane, stale, sky, up], "sky") == ""
    assert demo.wrong(["foreman: no agent can lift the parcel\n"], "") == ""
    assert demo.wrong([crane, up], "sky") == "crane has lifted the parcel, not sky"
    assert demo.wrong([sky], "sky") == "no agent has lifted the parcel, not sky"
    assert demo.wrong([sky, up], "") == "sky has lifted the parcel, not no agent"


@pytest.mark.few(0)
def test_substitute_copter_has_flown_the_lift(lfield_mission):
    team = run(lfield_mission, FAILURES[:1])
    assert max(point.up for point in team.tracks["sky.fc"]) > 1.0
    assert team.fake("sky.fc").facts["airborne"] is False

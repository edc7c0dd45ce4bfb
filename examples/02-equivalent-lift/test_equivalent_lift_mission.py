"""The runs of demo.py, on virtual time: `lfield test examples/02-equivalent-lift`."""

from __future__ import annotations

import re

import demo
import pytest

#: Seconds after which every host has detected a fault.
DETECTION_TIME = 8.0
#: Device and fault of each failure. Run n has the first n of them.
FAILURES = [(device, fault) for device, fault, _ in demo.FAILURES[1:]]


def run_with_failures(lfield_mission, failures):
    """Run the mission; the devices fail when the hook is down. Returns the team."""
    team = lfield_mission("mission.dL")
    team.crash(demo.CART)
    team.run(until="the parcel is coming")
    for device, fault in failures:
        team.fake(device).set(fault)
    team.run(DETECTION_TIME)
    team.boot(demo.CART)
    team.run(until_done=True)
    assert team.ended == {"foreman": "done"}
    return team


def lifts(team):
    """For each lift: the foreman's host, and the height in metres as text."""
    matches = [
        (line.host, re.match(r"foreman: the parcel went up by (.*) m$", line.text)) for line in team.log
    ]
    return [(host, match[1]) for host, match in matches if match]


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("failures", "lift", "message"),
    [
        (0, ("yard", "0.8"), "crane shall lift (direct, "),
        (1, ("air", None), "equivalent: climb-lifts of Climb"),
        (2, ("bench", "0.8"), "composed: grip-and-climb of Grip (hand), Climb (arm)"),
        (3, None, "no agent can lift the parcel"),
    ],
)
def test_best_then_equivalent_then_composed_lift_then_none(lfield_mission, failures, lift, message):
    team = run_with_failures(lfield_mission, FAILURES[:failures])
    assert team.said(message)
    if lift is None:
        assert lifts(team) == []
        for reason in ("crane: axis: no message", "sky: battery 0.15 (measured ", "hand: motor: no message"):
            assert team.said(reason)
        return
    ((host, height),) = lifts(team)
    assert host == lift[0]
    # The height is exact for the crane and the arm, but not for the copter.
    assert height == lift[1] or (lift[1] is None and abs(float(height) - 0.8) < 0.3)


def test_demonstration_reports_a_lift_by_the_wrong_robot():
    lifted, failed = "foreman: the parcel went up by 0.8 m\n", "foreman: crane could not: it is lost\n"
    crane, sky = "foreman: crane shall lift (direct)\n", "foreman: sky shall lift (equivalent)\n"
    assert demo.lift_error([crane, lifted], "crane") == ""
    assert demo.lift_error([crane, failed, sky, lifted], "sky") == ""
    assert demo.lift_error(["foreman: no agent can lift the parcel\n"], "") == ""
    assert demo.lift_error([crane, lifted], "sky") == "crane has lifted the parcel, not sky"
    assert demo.lift_error([sky], "sky") == "no agent has lifted the parcel, not sky"
    assert demo.lift_error([sky, lifted], "") == "sky has lifted the parcel, not no agent"


@pytest.mark.few(0)
def test_substitute_copter_flies_up_and_lands(lfield_mission):
    team = run_with_failures(lfield_mission, FAILURES[:1])
    assert max(point.up for point in team.tracks["sky.fc"]) > 1.0
    assert team.fake("sky.fc").facts["airborne"] is False

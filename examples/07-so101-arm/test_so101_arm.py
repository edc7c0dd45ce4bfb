"""Pick and place, on virtual time: `lfield test examples/07-so101-arm`."""

from __future__ import annotations

import re
from pathlib import Path

import drawn
import pytest

HERE = Path(__file__).parent
#: Metres: above an object, and the accuracy of the arm in the registry.
CLEARANCE, ACCURACY = 0.05, 0.01


def shows(svg):
    """The lines of a picture, in units of ten pixels."""
    lines = [re.findall(r"[0-9.]+", line) for line in re.findall(r'd="(M[^"]*)"', svg)]
    return [[round(float(number) / 10.0) for number in line] for line in lines]


@pytest.mark.parametrize("deployment", ["mission.dL", "dynamixel.dL"])
def test_all_cubes_are_sorted_with_either_kind_of_servos(lfield_mission, deployment):
    team = lfield_mission(deployment)
    team.run(until_done=True)
    assert team.ended == {"sorter": "done"}
    assert team.said("sorter: 3 of 3 cubes are in the box") == 1
    found = drawn.stops(team)
    assert len(found) == 6
    for target, tool in found:
        assert tool == pytest.approx([*target[:2], target[2] + CLEARANCE], abs=ACCURACY)
    if deployment == "mission.dL":
        assert shows(drawn.draw(team)) == shows((HERE / "arm.svg").read_text()), "run drawn.py"


@pytest.mark.few(0)
@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        ("hot@3=true", r"servo 3 \(elbow_flex\) has shut down: overheating; torque\(true\) restores it"),
        ("brownout@2=true", r"moveTo: servo 2 \(shoulder_lift\) has lost its torque without a fault"),
        ("dead@1=true", r"joints: servo 1 \(shoulder_pan\) does not answer"),
    ],
)
def test_servo_that_fails_in_motion_is_named_and_the_arm_stops(lfield_mission, fault, sentence):
    team = lfield_mission("mission.dL")
    team.run(until="cube 1 is gripped")
    team.run(0.5)
    team.fake("arm.joints").set(fault)
    team.run(
        until=lambda: any(re.search(f"sorter: .*: {sentence}", line.text) for line in team.log), at_most=60.0
    )


@pytest.mark.few(0)
def test_missing_cube_is_reported_as_not_gripped(lfield_mission):
    team = lfield_mission("mission.dL", fakes={"arm.jaw": ["obstacle=1000"]})
    team.run(until_done=True)
    assert team.said("cube 2 is not there") == 1
    assert team.said("0 of 3 cubes are in the box") == 1

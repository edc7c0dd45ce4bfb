"""Pick and place, on virtual time: `lfield test examples/07-so101-arm`."""

from __future__ import annotations

import re
from pathlib import Path

import draw_arm
import pytest

HERE = Path(__file__).parent
#: Metres: height of the tool above an object after a step; accuracy of the arm in the registry.
CLEARANCE, ACCURACY = 0.05, 0.01


def lines(svg):
    """The lines of a drawing, in units of ten pixels."""
    paths = [re.findall(r"[0-9.]+", path) for path in re.findall(r'd="(M[^"]*)"', svg)]
    return [[round(float(number) / 10.0) for number in path] for path in paths]


@pytest.mark.few(1)
@pytest.mark.parametrize("deployment", ["mission.dL", "dynamixel.dL"])
def test_arm_puts_all_cubes_into_the_box_with_either_kind_of_servo(lfield_mission, deployment):
    team = lfield_mission(deployment)
    team.run(until_done=True)
    assert team.ended == {"sorter": "done"}
    assert team.said("sorter: 3 of 3 cubes are in the box") == 1
    targets = draw_arm.targets(team)
    assert len(targets) == 6
    for target, tool in targets:
        assert tool == pytest.approx([*target[:2], target[2] + CLEARANCE], abs=ACCURACY)
    if deployment == "mission.dL":
        assert lines(draw_arm.draw(team)) == lines((HERE / "arm.svg").read_text()), "run draw_arm.py"


@pytest.mark.few(0)
@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("hot@3=true", r"servo 3 \(elbow_flex\) has shut down: overheating; torque\(true\) restores it"),
        ("brownout@2=true", r"moveTo: servo 2 \(shoulder_lift\) has lost its torque without a fault"),
        ("dead@1=true", r"joints: servo 1 \(shoulder_pan\) does not answer"),
    ],
)
def test_error_names_the_servo_that_fails_in_motion(lfield_mission, fault, message):
    team = lfield_mission("mission.dL")
    team.run(until="cube 1 is gripped")
    team.run(0.5)
    team.fake("arm.joints").set(fault)
    team.run(
        until=lambda: any(re.search(f"sorter: .*: {message}", line.text) for line in team.log), at_most=60.0
    )


@pytest.mark.few(0)
def test_missing_cube_is_reported_as_not_gripped(lfield_mission):
    team = lfield_mission("mission.dL", fakes={"arm.jaw": ["obstacle=1000"]})
    team.run(until_done=True)
    assert team.said("cube 2 is not there") == 1
    assert team.said("0 of 3 cubes are in the box") == 1

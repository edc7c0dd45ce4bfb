"""The mixed team, on virtual time: `lfield test examples/03-mixed-team`."""

from __future__ import annotations

import math
import re

import pytest


def test_copter_hands_the_parcel_over_to_the_gripper(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    assert team.ended == {"courier": "done"}
    steps = [line.text for line in team.log if line.text.startswith("courier: ")]
    assert [text.split(",")[0].split(" at ")[0] for text in steps[:4]] == [
        "courier: the copter has the parcel",
        "courier: the hook is",
        "courier: the hand has the parcel; the copter may land",
        "courier: the hook is back",
    ]
    assert not team.said("closed on nothing")
    (hook_depth,) = re.findall(r"the hook is at ([\d.]+) m", "\n".join(steps))
    assert float(hook_depth) == pytest.approx(1.2, abs=0.02)
    calls = {(call.resource, call.portal): call for call in team.calls}
    assert calls["hoist", "lower"].at < calls["carrier", "goTo"].ended, "the winch must not wait"
    track = team.tracks["carrier.fc"]
    assert max(math.hypot(point.north, point.east) for point in track) == pytest.approx(5.0, abs=0.5)
    assert track[0][1:3] == pytest.approx((-4.0, -2.0), abs=0.1), "the copter must start away from the dock"
    assert track[-1][1:3] == pytest.approx((0.0, 0.0), abs=0.6), "the copter must land at the dock"


@pytest.mark.few(0)
def test_each_device_ends_in_its_safe_state(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    team.stop()
    team.run(5.0)
    for device, state in (("carrier.fc", "land"), ("hoist.axis", "brake"), ("hand.motor", "torque_hold")):
        assert team.said(f"{device} in safe state '{state}': the host is stopping") == 1


@pytest.mark.few(0)
def test_silent_winch_ends_the_coordinator_and_the_copter_lands(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until="the copter has the parcel")
    team.fake("hoist.axis").set("silence=true")
    team.run(until_done=True)
    assert team.ended == {"courier": "died"}
    assert team.said("courier died of an uncaught Device")
    team.stop()
    team.run(40.0)
    assert team.fake("carrier.fc").facts["airborne"] is False

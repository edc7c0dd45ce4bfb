"""The kit of Dynamixel servos on the fake: every check passes, and each fault fails its check."""

from __future__ import annotations

from pathlib import Path

import pytest
from kit_findings import failed, not_run

#: The calibration of the example's arm.
SO101 = Path(__file__).parents[2] / "examples/07-so101-arm/so101.json"


def servos(desk, *specs):
    options = [argument for spec in specs for argument in (("--servo", spec) if spec[0] != "-" else (spec,))]
    return desk.fake("dynamixel", "--baud", "1000000", *options)


def test_servo_and_group_pass_the_kit(desk, run_kit_on):
    chain = servos(desk, "1:XM430-W350", "2:XL330-M288", "3:XM430-W350")
    binding = f'endpoint: "{chain.endpoint}", ttl: 0.3, limits: {{speed: 4.0}}'
    found = run_kit_on(
        "dynamixel",
        {
            "servo": f"type: Dynamixel, id: 1, {binding}",
            "group": f"type: DynamixelGroup, ids: [2, 3], {binding}",
        },
    )
    assert failed(found) == []
    assert {finding.outcome for finding in found.values()} == {"passed"}
    for device in ("servo", "group"):
        assert "has expired (time-to-live 0.3 s)" in found[device, "a setpoint that is not renewed ends"].seen
        assert found[device, "torque off at the end"].seen == "torque off"
    assert found["group", "every member answers"].seen == "2 members"


@pytest.mark.few(0)
def test_calibrated_feetech_servos_pass_the_kit(desk, run_kit_on):
    chain = servos(desk, *(f"{id}:STS3215" for id in (1, 2, 3, 7)), f"--calibration={SO101}")
    binding = f'endpoint: "{chain.endpoint}", protocol: 0, ttl: 0.3, limits: {{speed: 4.0}}'
    found = run_kit_on(
        "dynamixel",
        {
            "servo": f"type: Dynamixel, id: 7, waivers: [device_watchdog], {binding}",
            "group": f"type: DynamixelGroup, ids: [1, 2, 3], calibration: {SO101}, "
            f"waivers: [device_watchdog], {binding}",
        },
    )
    assert failed(found) == []
    assert {check for _, check in not_run(found)} == {"its watchdog stops it, and release() frees it"}


def test_faulty_servos_fail_their_checks(desk, run_kit_on):
    chain = servos(desk, "1:XM430-W350", "2:XL330-M288", "3:XL330-M288", "4:XM430-W350")
    binding = f'endpoint: "{chain.endpoint}", ttl: 0.3'
    supply, motion, members = (
        "supply and temperature are plausible",
        "turns there and back",
        "every member answers",
    )
    found = run_kit_on(
        "dynamixel",
        {
            "stuck": f"type: Dynamixel, id: 1, {binding}",
            "sagging": f"type: Dynamixel, id: 4, {binding}",
            "group": f"type: DynamixelGroup, ids: [2, 3], {binding}",
        },
        only=(supply, motion, members),
        first=lambda: chain.fault("stuck@1=true", "sag@4=10", "dead@3=true"),
        last=lambda: chain.fault("dead@3=false"),
    )
    assert "an obstacle blocks it" in found["stuck", motion].seen
    assert "it reports" in found["sagging", supply].seen
    assert "servo 3" in found["group", members].seen or "[3]" in found["group", members].seen
    assert found["stuck", supply].outcome == "passed"

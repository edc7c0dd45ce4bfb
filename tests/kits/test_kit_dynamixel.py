"""The kit of Dynamixel servos on the fake: every check passes, and each fault fails its check."""

from __future__ import annotations

from pathlib import Path

from kit_findings import failed, not_run

#: The calibration of the example's arm.
SO101 = Path(__file__).parents[2] / "examples/07-so101-arm/so101.json"


def servos(desk, *specs):
    options = [word for spec in specs for word in (("--servo", spec) if spec[0] != "-" else (spec,))]
    return desk.fake("dynamixel", "--baud", "1000000", *options)


def test_servo_and_group_pass_the_kit(desk, try_kit):
    chain = servos(desk, "1:XM430-W350", "2:XL330-M288", "3:XM430-W350")
    where = f'endpoint: "{chain.endpoint}", ttl: 0.3, limits: {{speed: 4.0}}'
    found = try_kit(
        "dynamixel",
        {"servo": f"type: Dynamixel, id: 1, {where}", "group": f"type: DynamixelGroup, ids: [2, 3], {where}"},
    )
    assert failed(found) == []
    assert {finding.outcome for finding in found.values()} == {"passed"}
    for device in ("servo", "group"):
        assert "has expired (time-to-live 0.3 s)" in found[device, "a setpoint that is not renewed ends"].seen
        assert found[device, "torque off at the end"].seen == "torque off"
    assert found["group", "every member answers"].seen == "2 members"


def test_feetech_servos_pass_as_they_were_calibrated(desk, try_kit):
    chain = servos(desk, *(f"{id}:STS3215" for id in (1, 2, 3, 7)), f"--calibration={SO101}")
    where = f'endpoint: "{chain.endpoint}", protocol: 0, ttl: 0.3, limits: {{speed: 4.0}}'
    found = try_kit(
        "dynamixel",
        {
            "servo": f"type: Dynamixel, id: 7, waivers: [device_watchdog], {where}",
            "group": f"type: DynamixelGroup, ids: [1, 2, 3], calibration: {SO101}, "
            f"waivers: [device_watchdog], {where}",
        },
    )
    assert failed(found) == []
    assert {check for _, check in not_run(found)} == {"its watchdog stops it, and release() frees it"}


def test_faulty_servos_fail_their_checks(desk, try_kit):
    chain = servos(desk, "1:XM430-W350", "2:XL330-M288", "3:XL330-M288", "4:XM430-W350")
    where = f'endpoint: "{chain.endpoint}", ttl: 0.3'
    volts, turn, all_there = (
        "supply and temperature are plausible",
        "turns there and back",
        "every member answers",
    )
    found = try_kit(
        "dynamixel",
        {
            "stuck": f"type: Dynamixel, id: 1, {where}",
            "sagging": f"type: Dynamixel, id: 4, {where}",
            "group": f"type: DynamixelGroup, ids: [2, 3], {where}",
        },
        only=(volts, turn, all_there),
        first=lambda: chain.fault("stuck@1=true", "sag@4=10", "dead@3=true"),
        last=lambda: chain.fault("dead@3=false"),
    )
    assert "something is in the way" in found["stuck", turn].seen
    assert "it reports" in found["sagging", volts].seen
    assert "servo 3" in found["group", all_there].seen or "[3]" in found["group", all_there].seen
    assert found["stuck", volts].outcome == "passed"

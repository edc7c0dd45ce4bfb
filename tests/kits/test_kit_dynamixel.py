"""The kit of Dynamixel servos on the fake: every check passes, and each fault fails its check."""

from __future__ import annotations

from kit_findings import failed


def servos(desk, *specs):
    options = [word for spec in specs for word in ("--servo", spec)]
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

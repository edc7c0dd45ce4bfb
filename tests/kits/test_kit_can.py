"""The kit of CAN devices on the fake: every check passes, and each fault fails its check."""

from __future__ import annotations

from pathlib import Path

import pytest
from kit_findings import failed, not_run

DBC = Path(__file__).parents[2] / "sim-adapters/lfield_sim/can/gripper.dbc"
STEERING = DBC.with_name("steering.dbc")
DRIVE = "type: CanAxis, protocol: cia402, counts: 10000, homing_method: 37"
ODRIVE = "type: CanAxis, protocol: odrive, waivers: [no_homing, device_watchdog]"


def test_drive_odrive_and_dbc_device_pass_the_kit(desk, run_kit_on):
    # An endpoint has one guard, so each device has its own bus.
    drive, odrive, gripper = (desk.fake("can", "--device", d) for d in ("cia402:5", "odrive:3", f"dbc:{DBC}"))
    found = run_kit_on(
        "can",
        {
            "drive": f'endpoint: "{drive.endpoint}", node: 5, {DRIVE}, limits: {{speed: 5.0, torque: 1.0}}',
            # With a TTL longer than the silence limit, the silence time-out always comes first.
            "odrive": f'endpoint: "{odrive.endpoint}", node: 3, {ODRIVE}, ttl: 1.6, limits: {{speed: 5.0}}',
            "gripper": f'endpoint: "{gripper.endpoint}", type: CanSignals, dbc: "{DBC}", '
            "commands: [GripperCommand], "
            "safe: [GripperCommand.TargetWidth=0.05, GripperCommand.TargetForce=0, GripperCommand.Enable=0], "
            "confirm: [GripperStatus.Enable=0], waivers: [device_watchdog]",
        },
    )
    assert failed(found) == []
    assert not_run(found) == {("odrive", "homing at its position")}
    assert "has expired (time-to-live 0.5 s)" in found["drive", "a velocity that is not renewed ends"].seen
    assert "the host was silent" in found["odrive", "a host that stops responding during a motion"].seen
    assert "GripperStatus.Width" in found["gripper", "its messages can be read"].seen
    assert (
        "allow only GripperCommand"
        in found["gripper", "messages that its binding does not list are refused"].seen
    )


@pytest.mark.few(0)
def test_protected_cyclic_commands_and_dronecan_nodes_pass_the_kit(desk, run_kit_on):
    """The fake column checks counter, checksum and deadline; one servo requests a dynamic node id."""
    protected = "[SteeringCommand.{0}, SteeringStatus.{0}]"
    binding = (
        f'dbc: "{STEERING}", commands: [SteeringCommand], cyclic: [SteeringCommand], '
        f"counters: {protected.format('Counter=15')}, checksums: {protected.format('Check=e2e_1 0x2A7')}, "
        "safe: [SteeringCommand.Enable=0, SteeringCommand.TargetAngle=0], "
        "confirm: [SteeringStatus.Enable=0], accepted: [SteeringStatus.Fault=0], waivers: [device_watchdog]"
    )
    devices = {
        "steering": f"type: CanSignals, {binding}",
        "battery": "type: DroneCanBattery, node: 40",
        "esc": "type: DroneCanEsc, node: 41, index: 3",
        "servo": "type: DroneCanServo, node: 42, waivers: [device_watchdog], safe_state: rest",
        "dynamic": f'type: DroneCanServo, node: 43, unique_id: "{"5a" * 16}", waivers: [device_watchdog], '
        "safe_state: hold",
    }
    specs = {
        "steering": f"dbc:{STEERING},commands=SteeringCommand,cycles=SteeringCommand,"
        "counters=SteeringCommand.Counter:15+SteeringStatus.Counter:15,"
        "checksums=SteeringCommand.Check:e2e_1/0x2A7+SteeringStatus.Check:e2e_1/0x2A7",
        "battery": "dronecan:40,functions=battery:0",
        "esc": "dronecan:41,functions=esc:3",
        "servo": "dronecan:42,functions=servo:0",
        "dynamic": f"dronecan:43,uid={'5a' * 16},dynamic=yes,functions=servo:0",
    }
    fakes = {name: desk.fake("can", "--device", spec) for name, spec in specs.items()}
    found = run_kit_on(
        "can", {name: f'endpoint: "{fakes[name].endpoint}", {text}' for name, text in devices.items()}
    )
    assert failed(found) == []
    # Sensors have no safe state.
    assert {device for device, _ in not_run(found)} == {"battery", "esc"}
    assert "has expired" in found["servo", "a setpoint that is not renewed ends"].seen


def test_faulty_axis_fails_its_checks(desk, run_kit_on):
    n5, n6, n7 = (desk.fake("can", "--device", f"cia402:{node}") for node in (5, 6, 7))
    n3 = desk.fake("can", "--device", "odrive:3")
    n5.fault("stuck@5=true")
    expiry, faults = "a velocity that is not renewed ends", "it responds without faults"
    found = run_kit_on(
        "can",
        {
            "n5": f'endpoint: "{n5.endpoint}", node: 5, {DRIVE}',
            "n6": f'endpoint: "{n6.endpoint}", node: 6, {DRIVE}',
            "n3": f'endpoint: "{n3.endpoint}", node: 3, {ODRIVE}',
        },
        only=("enabling does not move it", expiry),
    )
    assert found["n5", expiry].outcome == "failed"
    assert "does not turn it" in found["n5", expiry].seen or "blocked" in found["n5", expiry].seen
    assert found["n6", expiry].outcome == "passed"
    n7.fault("overheat@7=true")
    n3.fault("overcurrent@3=true")
    found = run_kit_on(
        "can",
        {
            "n7": f'endpoint: "{n7.endpoint}", node: 7, {DRIVE}',
            "n3": f'endpoint: "{n3.endpoint}", node: 3, {ODRIVE}',
        },
        only=(faults,),
    )
    assert "too hot" in found["n7", faults].seen
    assert "current" in found["n3", faults].seen.lower()

"""The bus classes of LeRobot with a simulated arm, used as for the SO-101 and Koch arms of LeRobot.

    lfield sim dynamixel --listen /tmp/arm --baud 1000000 --calibration examples/07-so101-arm/so101.json \
        $(printf -- '--servo %s:STS3215 ' 1 2 3 4 5 6)
    python tests/dynamixel/foreign/lerobot_bus.py feetech /tmp/arm examples/07-so101-arm/so101.json

In a separate environment: `pip install --no-deps lerobot` and `pip install deepdiff feetech-servo-sdk
dynamixel-sdk numpy pyserial tqdm`. This script replaces torch, accelerate and datasets by empty
modules: utilities of LeRobot import them, and its buses do not use them. Each line is one step. The exit
status is 1 if a step failed.
"""

from __future__ import annotations

import json
import math
import sys
import time
import types
from collections.abc import Callable
from typing import Any

MODELS = {"feetech": ["sts3215"] * 6, "dynamixel": ["xl430-w250"] * 2 + ["xl330-m288"] * 4}
GOALS = (30.0, -20.0, 40.0, 10.0, -45.0, 80.0)


class _Empty(types.ModuleType):
    """A module in which every name is an empty class."""

    def __getattr__(self, name: str) -> type:
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (), {})


def bus_of(kind: str, port: str, file: str) -> Any:
    """LeRobot's bus with the joints of a calibration file."""
    for name in ("torch", "accelerate", "datasets", "datasets.utils", "datasets.utils.logging"):
        sys.modules[name] = _Empty(name)
    from lerobot.motors import Motor, MotorCalibration, MotorNormMode
    from lerobot.motors.dynamixel import DynamixelMotorsBus
    from lerobot.motors.feetech import FeetechMotorsBus

    with open(file, encoding="utf-8") as stream:
        joints = {name: MotorCalibration(**entry) for name, entry in json.load(stream).items()}
    motors = {
        name: Motor(
            joint.id, model, MotorNormMode.RANGE_0_100 if name == "gripper" else MotorNormMode.DEGREES
        )
        for (name, joint), model in zip(joints.items(), MODELS[kind], strict=True)
    }
    return {"feetech": FeetechMotorsBus, "dynamixel": DynamixelMotorsBus}[kind](port, motors, joints)


def configure(bus: Any) -> bool:
    """The steps of SOFollower.configure, which write EEPROM. Return True if the torque is on afterwards."""
    with bus.torque_disabled():
        bus.configure_motors()
        if hasattr(bus, "protocol_version") and bus.protocol_version == 0:
            for motor in bus.motors:
                bus.write("P_Coefficient", motor, 16)
            bus.write("Max_Torque_Limit", "gripper", 500)
    return all(bus.sync_read("Torque_Enable", normalize=False).values())


def move_all(bus: Any) -> bool:
    """Write a goal for all joints, as in teleoperation. Return True if all reach their goals."""
    goals = dict(zip(bus.motors, GOALS, strict=True))
    bus.sync_write("Goal_Position", goals)
    time.sleep(3.0)  # The simulated servos run in real time.
    positions = bus.sync_read("Present_Position")
    return all(math.isclose(positions[name], goal, abs_tol=1.0) for name, goal in goals.items())


def centre_all(bus: Any) -> bool:
    """The homing of lerobot-calibrate. Return True if every joint is in the middle of its turn afterwards."""
    bus.disable_torque()
    if "dynamixel" in type(bus).__module__:
        for motor in bus.motors:
            # The Koch arm uses the extended mode, in which offsets are not limited.
            bus.write("Operating_Mode", motor, 4)
    bus.set_half_turn_homings()
    return all(abs(p - 2047) <= 1 for p in bus.sync_read("Present_Position", normalize=False).values())


def restore_calibration(bus: Any, joints: dict[str, Any]) -> bool:
    """Write the calibration. Return True if the servos have it afterwards."""
    bus.write_calibration(joints)
    return bool(bus.is_calibrated)


def main() -> int:
    """Run all steps. Return the exit status."""
    bus = bus_of(*sys.argv[1:4])
    joints, failed = dict(bus.calibration), 0
    steps: list[tuple[str, Callable[[], object]]] = [
        ("connect with handshake", lambda: (bus.connect(), bus.is_connected)[1]),
        ("broadcast ping finds all", lambda: len(bus.broadcast_ping()) == len(joints)),
        ("the servos have the calibration", lambda: bus.is_calibrated),
        ("configure writes EEPROM", lambda: configure(bus)),
        ("sync write and sync read", lambda: move_all(bus)),
        ("half-turn homing", lambda: centre_all(bus)),
        ("the calibration is written back", lambda: restore_calibration(bus, joints)),
        ("disconnect", lambda: (bus.disconnect(), not bus.is_connected)[1]),
    ]
    for name, step in steps:
        passed = bool(step())
        failed += not passed
        print(f"{'passed' if passed else 'FAILED'}: {name}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

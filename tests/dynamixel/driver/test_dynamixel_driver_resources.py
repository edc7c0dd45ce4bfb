"""The resource types of the driver compile with its manifests, and a mission that includes them compiles."""

from __future__ import annotations

import pytest

from lfield.driver.device import check_methods
from lfield.lang.frontend import check_file, check_text
from lfield_dynamixel import PLUGIN
from lfield_dynamixel.devices import Dynamixel, DynamixelGroup

DEVICES = {name: manifest.device for name, manifest in PLUGIN.read_manifests().items()}

MISSION = """
include <dynamixel/servo.L>;
include <dynamixel/arm.L>;
include <dynamixel/gripper.L>;

coordinator Pick {
    init(string[] arg) {
        Arm arm = findArm("left");
        Gripper hand = findGripper("hand");
        Servo pan = findServo("pan");
        pan.moveTo(0.5);
        print(f2s(pan.velocity()) + f2s(pan.current()) + f2s(pan.effort()) + f2s(pan.voltage()));
        arm.home();
        if (hand.grip(0.3)) arm.moveTo(arm.position());
        if (!hand.grip() || !hand.holding()) hand.release();
    }
}
"""


@pytest.mark.parametrize("name", ["servo", "arm", "gripper"])
def test_dynamixel_stock_resource_compiles(name):
    path = PLUGIN.source(f"{name}.L")
    assert path is not None
    checked = check_file(path, devices=DEVICES)
    assert [d.render() for d in checked.diagnostics] == []


def test_mission_includes_all_stock_resources():
    def find(path: str):
        return PLUGIN.source(path.removeprefix("dynamixel/"))

    checked = check_text(MISSION, devices=DEVICES, find_include=find)
    assert [d.render() for d in checked.diagnostics] == []


def test_every_instruction_has_its_method():
    manifests = PLUGIN.read_manifests()
    check_methods(Dynamixel, manifests["Dynamixel"])
    check_methods(DynamixelGroup, manifests["DynamixelGroup"])


def test_driver_class_is_loaded():
    assert PLUGIN.load().__name__ == "DynamixelDriver"

"""The Dynamixel driver: servos and groups of servos on a half-duplex bus. See README.md in this folder."""

from lfield.driver import Plugin

PLUGIN = Plugin(
    name="dynamixel",
    package="lfield_dynamixel",
    driver="lfield_dynamixel.driver:DynamixelDriver",
    extra="dynamixel",
    requires=("dynamixel_sdk", "serial"),
    manifests=("servo.yaml", "group.yaml"),
    kit="lfield_dynamixel.kit:KIT",
    endpoint="lfield.driver.serial:parse_serial_endpoint",
)

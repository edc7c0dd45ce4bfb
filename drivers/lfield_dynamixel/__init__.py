"""The Dynamixel driver: DYNAMIXEL and Feetech servos, and groups of them, on a bus. See README.md."""

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
    conflicts="lfield_dynamixel.joints.mounting:conflicts_of",
    files="lfield_dynamixel.joints.calibration:mistakes_in",
)

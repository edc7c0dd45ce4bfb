"""The CAN driver: axes of CiA 402 drives and ODrives, devices described by a DBC file, and
DroneCAN nodes. See README.md."""

from lfield.driver import Plugin

PLUGIN = Plugin(
    name="can",
    package="lfield_can",
    driver="lfield_can.driver:CanDriver",
    extra="can",
    requires=("can", "canopen", "cantools"),
    manifests=(
        "axis.yaml",
        "signals.yaml",
        "drone_can/battery.yaml",
        "drone_can/esc.yaml",
        "drone_can/servo.yaml",
    ),
    kit="lfield_can.kit:KIT",
    endpoint="lfield_can.bus.endpoint:parse_endpoint",
    files="lfield_can.driver:mistakes_in",
)

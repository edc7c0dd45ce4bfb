"""The CAN driver: axes of CiA 402 drives and ODrives, and devices described by a DBC file. See README.md."""

from lfield.driver import Plugin

PLUGIN = Plugin(
    name="can",
    package="lfield_can",
    driver="lfield_can.driver:CanDriver",
    extra="can",
    requires=("can", "canopen", "cantools"),
    manifests=("axis.yaml", "signals.yaml"),
    kit="lfield_can.kit:KIT",
    endpoint="lfield_can.bus.endpoint:parse_endpoint",
    files="lfield_can.driver:mistakes_in",
)

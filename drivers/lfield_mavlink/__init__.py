"""The MAVLink driver: vehicles with ArduPilot or PX4. See README.md in this folder."""

from lfield.driver import Plugin

PLUGIN = Plugin(
    name="mavlink",
    package="lfield_mavlink",
    driver="lfield_mavlink.driver:MavlinkDriver",
    extra="mavlink",
    requires=("pymavlink", "serial"),
    kit="lfield_mavlink.kit:KIT",
)

"""The MAVLink driver: copters and rovers with ArduPilot. See README.md in this folder."""

from lfield.driver import Plugin

PLUGIN = Plugin(
    name="mavlink",
    package="lfield_mavlink",
    driver="lfield_mavlink.driver:MavlinkDriver",
    extra="mavlink",
    requires=("pymavlink",),
)

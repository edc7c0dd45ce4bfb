"""The MAVLink driver: vehicles with ArduPilot or PX4. See README.md in this folder.

`driver` is the bus and `vehicle` what is on it. Below them, each seeing those before it: `link` (bytes to
messages), `contact` (one vehicle heard and asked), `services` (protocols beside flight), `parts` (what it can
do, by topic). `kit` tries it all.
"""

from lfield.driver import Plugin

PLUGIN = Plugin(
    name="mavlink",
    package="lfield_mavlink",
    driver="lfield_mavlink.driver:MavlinkDriver",
    extra="mavlink",
    requires=("pymavlink", "serial"),
    kit="lfield_mavlink.kit:KIT",
    endpoint="lfield_mavlink.link.links:parse_endpoint",
    conflicts="lfield_mavlink.link.station:station_conflicts",
)

"""The MAVLink driver for ArduPilot and PX4 vehicles. See README.md in this folder.

`driver` is the bus and `vehicle` a vehicle on it. They use, in layers: `link` (bytes to messages), `contact`
(communication with one vehicle), `services` (protocols other than flight), `parts` (instructions by topic).
`files` reads mission and parameter files. `kit` is the conformance kit.
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
    conflicts="lfield_mavlink.station_ids:station_conflicts",
    plans="lfield_mavlink.files.plan_report:read_plan",
    plan_texts="lfield_mavlink.files.plan_text:embedded_plan",
)

"""The driver 'gps' for GNSS receivers with NMEA 0183, devices of the type Gps. See README.md."""

from lfield.driver import Plugin

PLUGIN = Plugin(
    name="gps",
    package="lfield_gps",
    driver="lfield_gps.driver:GpsDriver",
    extra="serial",
    requires=("serial",),
    kit="lfield_gps.kit:KIT",
    endpoint="lfield.driver.serial:parse_serial_endpoint",
)

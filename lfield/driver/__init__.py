"""The public interface for driver authors (docs/driver-authors.md); conformance kits also import
`lfield.driver.kit`.

A plugin provides a `Driver` with its `Device`s. The package also has their bindings, their reports, and the
helper types.
"""

from lfield.clock import Clock
from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import WATCHDOG, Manifest, Reports
from lfield.driver.device import Device, Driver
from lfield.driver.frame import Frame, Origin, Placement, Pose, Vector
from lfield.driver.plugin import Plugin
from lfield.driver.recording import WireLog
from lfield.driver.settings import Setting, SettingChange, SettingsComparison, is_same_value
from lfield.errors import DeviceError, MissionFileError
from lfield.geodata.findings import FileFinding
from lfield.geodata.mission_files import (
    PlanPoint,
    PlanReport,
    PlanRequest,
    PlanZone,
    ascii_number,
    utf8_bytes,
)
from lfield.geodata.polygons import (
    LocalPlane,
    crosses,
    crossing_edges,
    distance_to_way,
    is_inside,
)
from lfield.text.input_files import read_within
from lfield.text.log_messages import LogMessage
from lfield.text.message_tables import FindingTable
from lfield.text.source_text import Diagnostic, Diagnostics, Source, Span

__all__ = [
    "WATCHDOG",
    "Clock",
    "Device",
    "DeviceBinding",
    "DeviceError",
    "Diagnostic",
    "Diagnostics",
    "Driver",
    "FileFinding",
    "FindingTable",
    "Frame",
    "LocalPlane",
    "LogMessage",
    "Manifest",
    "MissionFileError",
    "Origin",
    "Placement",
    "PlanPoint",
    "PlanReport",
    "PlanRequest",
    "PlanZone",
    "Plugin",
    "Pose",
    "Reports",
    "Setting",
    "SettingChange",
    "SettingsComparison",
    "Source",
    "Span",
    "Vector",
    "WireLog",
    "ascii_number",
    "crosses",
    "crossing_edges",
    "distance_to_way",
    "is_inside",
    "is_same_value",
    "read_within",
    "utf8_bytes",
]

"""All that a driver imports; its conformance kit imports `lfield.driver.kit` beside it (docs/drivers.md).

The contract is here: a plugin's `Driver` and its `Device`s, what they are bound by, what they tell, and the
few words of lfield that they speak.
"""

from lfield.clock import Clock
from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import WATCHDOG, Manifest, Reports
from lfield.driver.device import Device, Driver
from lfield.driver.frame import Frame, Origin, Placement, Pose, Vector
from lfield.driver.plugin import Plugin
from lfield.driver.settings import Setting
from lfield.errors import DeviceError
from lfield.text.files import read_within
from lfield.text.findings import Table
from lfield.text.source import Diagnostic, Diagnostics, Source, Span

__all__ = [
    "WATCHDOG",
    "Clock",
    "Device",
    "DeviceBinding",
    "DeviceError",
    "Diagnostic",
    "Diagnostics",
    "Driver",
    "Frame",
    "Manifest",
    "Origin",
    "Placement",
    "Plugin",
    "Pose",
    "Reports",
    "Setting",
    "Source",
    "Span",
    "Table",
    "Vector",
    "read_within",
]

"""Everything a driver plugin may import: the contract, and the guard that runs it (DESIGN section 7)."""

from lfield.driver.binding import DeviceBinding
from lfield.driver.device import Device, Driver, Reports
from lfield.driver.plugin import Plugin
from lfield.manifest import Manifest

__all__ = ["Device", "DeviceBinding", "Driver", "Manifest", "Plugin", "Reports"]

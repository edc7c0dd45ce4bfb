"""Reads the stored settings of devices and writes the settings that their bindings need (`lfield setup`).

Devices are accessed in this process without a guard, since no device is commanded. An endpoint in use by
another process is reported.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

from msgspec import Struct

from lfield.clock import Clock
from lfield.devices.parameter_backup import BackupEntry, ParameterChange, device_label, write_backup
from lfield.driver.binding import DeviceBinding, by_bus
from lfield.driver.device import Device, Driver
from lfield.driver.driver_index import DriverLookup
from lfield.driver.plugin import check_same, load_plugin
from lfield.driver.settings import Setting, mismatched
from lfield.errors import DeviceError, DevicesError, LfieldError, PluginError
from lfield.guard.endpoint_lock import EndpointLock
from lfield.manifest import DeviceValue

#: Receives one log line.
Report = Callable[[str], None]


class FoundDevice(Struct, frozen=True):
    """A device that responds, with its stored settings.

    `serial` is its unique identifier, '' for none; not read for a device without stored settings.
    """

    device: Device
    identity: str
    settings: Sequence[Setting]
    serial: str = ""

    @property
    def name(self) -> str:
        """`alpha.fc`."""
        return self.device.binding.name

    @property
    def label(self) -> str:
        """`ArduPilot copter, system 1, uid 3f21`."""
        return device_label(self.identity, self.serial)

    @property
    def mismatched(self) -> list[Setting]:
        """The settings to be written."""
        return mismatched(self.settings)


class _SetupReports:
    """Reports of devices during setup: notes are shown, telemetry is discarded."""

    def __init__(self, report: Report) -> None:
        self._report = report

    def publish(self, device: str, values: Mapping[str, DeviceValue]) -> None:
        """Ignores telemetry, which is not used."""

    def heard(self, device: str) -> None:
        """Ignores contact: responses are sufficient."""

    def note(self, device: str, text: str) -> None:
        """Shows a sentence to the user."""
        self._report(f"{device}: {text}")

    def breach(self, device: str, reason: str) -> None:
        """Shows the reason: no device is moved here, but another controller may move it."""
        self._report(f"{device}: {reason}")

    def lock_out(self, device: str, reason: str) -> None:
        """Shows the reason: no device is moved here, but another controller may move it."""
        self._report(f"{device}: {reason}")

    def crashed(self, reason: str | BaseException) -> None:
        """Shows the reason; the current request fails by itself."""
        self._report(f"the driver failed: {reason}")


class _Bus:
    """The devices of one bus, without a guard."""

    def __init__(
        self, drivers: DriverLookup, bindings: Sequence[DeviceBinding], clock: Clock, report: Report
    ) -> None:
        self._known, self._bindings = drivers.by_driver[bindings[0].driver], bindings
        self._clock, self._report, self._lock = clock, report, EndpointLock()
        self._driver: Driver | None = None
        self.found: list[FoundDevice] = []

    async def open(self) -> list[str]:
        """Finds all devices; returns a sentence per problem."""
        names = ", ".join(binding.name for binding in self._bindings)
        try:
            await self._lock.acquire(self._bindings[0].endpoint)
            plugin = load_plugin(self._known.reference)
            check_same(self._known, plugin)
            make, manifests = plugin.load(), self._known.manifests
            self._driver = make(self._bindings, manifests, self._clock, _SetupReports(self._report))
            await self._driver.open()
        except DeviceError as error:
            return [f"{names}: {error.reason}"]
        except PluginError as error:
            return [f"{names}: {error}"]
        except Exception as error:  # a driver is third-party code: report any exception
            return [f"{names}: the driver failed to open: {error!r}"]
        inspected = await asyncio.gather(
            *map(_inspect, self._driver.devices.values()), return_exceptions=True
        )
        self.found = [each for each in inspected if isinstance(each, FoundDevice)]
        return [
            failure_sentence(binding.name, each)
            for binding, each in zip(self._bindings, inspected, strict=True)
            if isinstance(each, BaseException)
        ]

    async def close(self) -> None:
        try:
            if self._driver is not None:
                await self._driver.close()
        except Exception as error:  # a driver is third-party code: report any exception
            self._report(f"the driver '{self._known.name}' did not close its devices: {error!r}")
        finally:
            self._lock.release()


async def _inspect(device: Device) -> FoundDevice:
    identity = await device.find()
    settings = await device.settings()
    if not settings:
        return FoundDevice(device, identity, settings)
    # This is checked first: if it fails, the binding must change before any setting.
    await device.check_watchdog()
    return FoundDevice(device, identity, settings, await device.serial())


def failure_sentence(name: str, error: BaseException) -> str:
    """The sentence about a request to device `name` that its driver could not execute.

    Raises `error` itself if it is not the driver's: a cancellation, or a file that cannot be written.
    """
    if isinstance(error, DeviceError):
        return f"{name}: {error.reason}"
    if isinstance(error, PluginError):
        return f"{name}: {error}"
    if isinstance(error, LfieldError) or not isinstance(error, Exception):
        raise error
    return f"{name}: the driver failed: {error!r}"


@asynccontextmanager
async def open_devices(
    drivers: DriverLookup, devices: Sequence[DeviceBinding], clock: Clock, report: Report
) -> AsyncIterator[list[FoundDevice]]:
    """Opens all devices for the duration of the block, in the order of their bindings.

    Raises DevicesError with all problems.
    """
    buses = [_Bus(drivers, bus, clock, report) for bus in by_bus(devices).values()]
    try:
        problems = await asyncio.gather(*(bus.open() for bus in buses))
        if any(problems):
            raise DevicesError([problem for reported in problems for problem in reported])
        found = {each.name: each for bus in buses for each in bus.found}
        yield [found[device.name] for device in devices]
    finally:
        await asyncio.gather(*(bus.close() for bus in buses))


async def write_settings(found: Sequence[FoundDevice], folder: Path, when: str, report: Report) -> None:
    """Writes wrong settings after a backup of the present values; `when` is the present time in words.

    Raises DevicesError with all settings that could not be written or are still wrong.
    """
    meant = [each for each in found if each.mismatched]
    problems = await _for_each(meant, _check_idle)
    if problems:
        raise DevicesError(problems)
    backup = write_backup(folder, [_entry(each, when) for each in meant])
    report(f"the present values are saved in {backup}; 'lfield setup --apply {backup}' restores them")
    problems = await _for_each(meant, lambda each: _write(each, report))
    if problems:
        raise DevicesError(problems)


async def _check_idle(found: FoundDevice) -> None:
    found.device.check_idle()


async def _for_each(found: Sequence[FoundDevice], act: Callable[[FoundDevice], Awaitable[None]]) -> list[str]:
    """Runs an action for each device, independently; returns a sentence per failure."""
    done = await asyncio.gather(*(act(each) for each in found), return_exceptions=True)
    return [
        failure_sentence(each.name, error)
        for each, error in zip(found, done, strict=True)
        if isinstance(error, BaseException)
    ]


def _entry(found: FoundDevice, when: str) -> BackupEntry:
    changes = [ParameterChange(setting.name, setting.present, setting.wanted) for setting in found.mismatched]
    return BackupEntry(when, found.identity, changes, found.device.binding, found.serial)


async def _write(found: FoundDevice, report: Report) -> None:
    for setting in found.mismatched:
        await found.device.write_setting(setting.name, setting.wanted)
        report(f"{found.name}: {setting.name} was {setting.present:.9g} and is now {setting.wanted:.9g}")
    await found.device.check_settings()

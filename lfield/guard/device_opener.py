"""Opens the devices of a guard, and closes them when the guard must end while it opens them.

A device that was only queried is left unchanged. Opening is completed first for a device that it may have
changed, so that it can be made safe; if this takes too long, the device is reported as unsafe.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from lfield.clock import Clock
from lfield.driver.contract import Reports
from lfield.driver.device import NOT_SET_UP, Device, Driver, check_methods
from lfield.driver.plugin import Plugin, check_same
from lfield.errors import DeviceError, DeviceNotSetUp, PluginError
from lfield.guard.endpoint_lock import EndpointGuard
from lfield.guard.messages import OpenDevices
from lfield.guard.recording.guard_rings import start_wire_log
from lfield.text import log_messages

#: Seconds to complete the opening of changed devices when the guard must end.
FINISH_TIMEOUT = 3.0

#: Device ('' for the bus), error kind and reason.
OpenProblem = tuple[str, str, str]


class DeviceOpener:
    """Opens the devices of one bus, and owns the endpoint and the driver afterwards.

    `on_loaded` is called when the driver is imported, before it opens a device.
    """

    def __init__(
        self,
        plugin: Plugin,
        clock: Clock,
        reports: Reports,
        on_loaded: Callable[[], None],
        lock: EndpointGuard,
    ) -> None:
        self._plugin, self._clock, self._reports, self._on_loaded = plugin, clock, reports, on_loaded
        self._lock = lock
        self._tasks: dict[str, tuple[Device, asyncio.Task[str]]] = {}
        #: The devices that the program may have moved before a restart of the guard; None without a restart.
        self._moved_before: list[str] | None = None
        #: The driver, None before it is created.
        self.driver: Driver | None = None
        #: The actions of open devices in their safe states, if they differ from the names of the states.
        self.safe_actions: dict[str, dict[str, str]] = {}

    def on_request(self, message: OpenDevices) -> None:
        """The host requests the opening; `run` follows."""
        if message.latched:
            self._moved_before = [device.name for device in message.devices if not device.is_sensor]

    async def run(self, message: OpenDevices) -> tuple[dict[str, str], list[OpenProblem]]:
        """Opens all devices concurrently; returns identities by name, and all problems.

        An abandoned device is in neither of them.
        """
        try:
            await self._lock.acquire(message.devices[0].endpoint)
            self.driver = self._make_driver(message)
            start_wire_log(self.driver.wire_log, message, self._reports.note)
            self._on_loaded()
            await self.driver.open()
            return await self._open_all(list(self.driver.devices.values()), message.foreign_controlled)
        except DeviceError as error:
            problem = ("", error.kind, error.reason)
        except PluginError as error:
            problem = ("", "DeviceException", str(error))
        except Exception as error:  # a driver is third-party code: report any exception
            problem = ("", "DeviceException", f"the driver failed to open: {error!r}")
        return {}, [problem]

    def _make_driver(self, message: OpenDevices) -> Driver:
        check_same(message.driver, self._plugin)
        driver = self._plugin.load()(message.devices, message.driver.manifests, self._clock, self._reports)
        for device in driver.devices.values():
            check_methods(type(device), device.manifest, device.parts)
        return driver

    async def _open_all(
        self, devices: list[Device], foreign_controlled: list[str]
    ) -> tuple[dict[str, str], list[OpenProblem]]:
        is_restart = self._moved_before is not None
        work = [asyncio.ensure_future(device.open(again=is_restart)) for device in devices]
        names = [device.binding.name for device in devices]
        self._tasks = dict(zip(names, zip(devices, work, strict=True), strict=True))
        answers = dict(zip(names, await asyncio.gather(*work, return_exceptions=True), strict=True))
        problems = [_problem(name, error) for name, error in answers.items() if isinstance(error, Exception)]
        for device in devices if is_restart and not problems else ():
            device.guard_restarted(device.binding.name in foreign_controlled)
        identities = {name: answer for name, answer in answers.items() if isinstance(answer, str)}
        opened = [device for device in devices if device.binding.name in identities]
        self.safe_actions = {d.binding.name: actions for d in opened if (actions := d.safe_actions())}
        return identities, problems

    @property
    def commanded(self) -> list[str]:
        """The devices that opening, or the program before a restart of the guard, may have changed."""
        if self._moved_before is not None:
            return self._moved_before
        return [name for name, (device, _) in self._tasks.items() if device.touched()]

    def abandon(self) -> float | None:
        """Abandons devices that were only queried; returns the time limit of the others in seconds, None for
        no limit.

        There is no limit for devices that the program may have moved before a restart of the guard.
        """
        if self._moved_before is not None:
            return None
        touched = self.commanded
        for name, (_, task) in self._tasks.items():
            if name not in touched:
                task.cancel()
        return FINISH_TIMEOUT if touched else 0.0

    async def close(self) -> None:
        """Closes the bus."""
        if self.driver is not None:
            try:
                await self.driver.close()
            except Exception as error:  # third-party code; what follows must be closed too
                self._reports.note("the driver", log_messages.DRIVER_NOT_CLOSED.line(reason=repr(error)))
            self.driver.wire_log.close()
        self._lock.release()


def _problem(name: str, error: Exception) -> OpenProblem:
    if isinstance(error, DeviceError):
        return name, NOT_SET_UP if isinstance(error, DeviceNotSetUp) else error.kind, error.reason
    return name, "DeviceException", f"the driver failed: {error!r}"

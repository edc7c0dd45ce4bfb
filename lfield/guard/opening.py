"""How a guard opens its devices, and which of them it may leave as they are when it has to end meanwhile.

A device that was only asked is left at once. One that opening may have changed is opened to the end first, so
that it can be made safe; if that takes too long it is named, for nobody knows how it is.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from lfield.clock import Clock
from lfield.driver.contract import Reports
from lfield.driver.device import NOT_SET_UP, Device, Driver, check_methods
from lfield.driver.plugin import Plugin, check_same
from lfield.errors import DeviceError, NotSetUp, PluginError
from lfield.guard.endpoint_lock import Lock
from lfield.guard.messages import Open

#: Seconds for what opening has begun to change to be open, once the guard has to end.
FINISH = 3.0

#: A device (or '' for the bus), the kind of what is wrong with it, and why in words.
Problem = tuple[str, str, str]


class Opening:
    """The opening of the devices of one bus, and what is held from then on: its endpoint and the driver.

    `on_loaded` is called when the driver's code is there, before it opens anything.
    """

    def __init__(
        self,
        plugin: Plugin,
        clock: Clock,
        reports: Reports,
        on_loaded: Callable[[], None],
        lock: Lock,
    ) -> None:
        self._plugin, self._clock, self._reports, self._on_loaded = plugin, clock, reports, on_loaded
        self._lock = lock
        self._tasks: dict[str, tuple[Device, asyncio.Task[str]]] = {}
        self._again = False
        #: The driver, None before it is made.
        self.driver: Driver | None = None

    async def run(self, message: Open) -> tuple[dict[str, str], list[Problem]]:
        """Open them all at once: identities by name, and all that went wrong; who was left is in neither."""
        self._again = bool(message.latched)
        try:
            await self._lock.take(message.devices[0].endpoint)
            self.driver = self._made(message)
            self._on_loaded()
            await self.driver.open()
            return await self._opened(list(self.driver.devices.values()), message.taken)
        except DeviceError as error:
            problem = ("", error.kind, error.reason)
        except PluginError as error:
            problem = ("", "DeviceException", str(error))
        except Exception as error:  # a driver is foreign code: whatever it raises is reported, not lost
            problem = ("", "DeviceException", f"the driver failed to open: {error!r}")
        return {}, [problem]

    def _made(self, message: Open) -> Driver:
        check_same(message.driver, self._plugin)
        driver = self._plugin.load()(message.devices, message.driver.manifests, self._clock, self._reports)
        for device in driver.devices.values():
            check_methods(type(device), device.manifest, device.parts)
        return driver

    async def _opened(self, devices: list[Device], taken: list[str]) -> tuple[dict[str, str], list[Problem]]:
        work = [asyncio.ensure_future(device.open(again=self._again)) for device in devices]
        names = [device.binding.name for device in devices]
        self._tasks = dict(zip(names, zip(devices, work, strict=True), strict=True))
        answers = dict(zip(names, await asyncio.gather(*work, return_exceptions=True), strict=True))
        problems = [_problem(name, error) for name, error in answers.items() if isinstance(error, Exception)]
        for device in devices if self._again and not problems else ():
            device.guard_restarted(device.binding.name in taken)
        return {name: answer for name, answer in answers.items() if isinstance(answer, str)}, problems

    @property
    def touched(self) -> list[str]:
        """The devices that may not be as they were before; all when the guard before this one had them."""
        return [name for name, (device, _) in self._tasks.items() if self._again or device.touched()]

    def leave(self) -> float | None:
        """Give up those that were only asked; how many seconds the others have, None for as many as it takes.

        What the program may have moved before must be made safe, however long it takes to find it again.
        """
        touched = self.touched
        for name, (_, task) in self._tasks.items():
            if name not in touched:
                task.cancel()
        return None if self._again else FINISH if touched else 0.0

    async def close(self) -> None:
        """Give the bus back."""
        if self.driver is not None:
            await self.driver.close()
        self._lock.release()


def _problem(name: str, error: Exception) -> Problem:
    if isinstance(error, DeviceError):
        return name, NOT_SET_UP if isinstance(error, NotSetUp) else error.kind, error.reason
    return name, "DeviceException", f"the driver failed: {error!r}"

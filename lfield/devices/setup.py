"""Looks at what devices keep, and writes what their bindings need (`back` puts back what was there).

Devices are reached in this process, without a guard, since nothing is commanded: they are found, their
settings are read and written, and that is all. Who else has an endpoint is told of, as to a guard.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass

from lfield.clock import Clock
from lfield.devices.kept import Change, Entry, Kept, in_words
from lfield.driver.binding import DeviceBinding, by_bus
from lfield.driver.device import Device, Driver
from lfield.driver.known import Drivers
from lfield.driver.plugin import check_same, load_plugin
from lfield.driver.settings import Setting, wrong
from lfield.errors import DeviceError, DevicesError, PluginError
from lfield.guard.endpoint_lock import EndpointLock
from lfield.manifest import DeviceValue

#: Takes one line of what was done.
Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Found:
    """A device that answers, and what it keeps of what its binding needs.

    `serial` is what it has of its own, '' for nothing; a device that keeps nothing is not asked.
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
    def who(self) -> str:
        """`ArduPilot copter, system 1, uid 3f21`."""
        return in_words(self.identity, self.serial)

    @property
    def wrong(self) -> list[Setting]:
        """What is to be written."""
        return wrong(self.settings)


class _Quiet:
    """Reports of devices that are only looked at: their notes are told, their telemetry is nobody's."""

    def __init__(self, tell: Tell) -> None:
        self._tell = tell

    def publish(self, device: str, values: Mapping[str, DeviceValue]) -> None:
        """Nobody asks for it."""

    def heard(self, device: str) -> None:
        """Its answers show it."""

    def note(self, device: str, text: str) -> None:
        """A sentence for whoever sits here."""
        self._tell(f"{device}: {text}")

    def breach(self, device: str, reason: str) -> None:
        """Nothing is moved here: told, for whoever moves it."""
        self._tell(f"{device}: {reason}")

    def lock_out(self, device: str, reason: str) -> None:
        """Nothing is moved here: told, for whoever moves it."""
        self._tell(f"{device}: {reason}")

    def crashed(self, reason: str | BaseException) -> None:
        """Told; what was asked then fails by itself."""
        self._tell(f"the driver failed: {reason}")


class _Bus:
    """The devices of one bus, without a guard."""

    def __init__(self, drivers: Drivers, bindings: Sequence[DeviceBinding], clock: Clock, tell: Tell) -> None:
        self._known, self._bindings = drivers.by_driver[bindings[0].driver], bindings
        self._clock, self._reports, self._lock = clock, _Quiet(tell), EndpointLock()
        self._driver: Driver | None = None
        self.found: list[Found] = []

    async def open(self) -> list[str]:
        """Find all of them; what went wrong, a sentence each."""
        names = ", ".join(binding.name for binding in self._bindings)
        try:
            await self._lock.take(self._bindings[0].endpoint)
            plugin = load_plugin(self._known.reference)
            check_same(self._known, plugin)
            make, manifests = plugin.load(), self._known.manifests
            self._driver = make(self._bindings, manifests, self._clock, self._reports)
            await self._driver.open()
        except DeviceError as error:
            return [f"{names}: {error.reason}"]
        except PluginError as error:
            return [f"{names}: {error}"]
        except Exception as error:  # a driver is foreign code: whatever it raises is told, not lost
            return [f"{names}: the driver failed to open: {error!r}"]
        looked = await asyncio.gather(*map(_look, self._driver.devices.values()), return_exceptions=True)
        self.found = [each for each in looked if isinstance(each, Found)]
        return [
            _problem(binding.name, each)
            for binding, each in zip(self._bindings, looked, strict=True)
            if isinstance(each, BaseException)
        ]

    async def close(self) -> None:
        """Give the bus back."""
        if self._driver is not None:
            await self._driver.close()
        self._lock.release()


async def _look(device: Device) -> Found:
    identity = await device.find()
    settings = await device.settings()
    if not settings:
        return Found(device, identity, settings)
    # What is written would not be enough: the binding is what must change first.
    await device.check_watchdog()
    return Found(device, identity, settings, await device.serial())


def _problem(name: str, error: BaseException) -> str:
    if isinstance(error, DeviceError):
        return f"{name}: {error.reason}"
    if isinstance(error, Exception):  # a driver is foreign code
        return f"{name}: the driver failed: {error!r}"
    raise error


@asynccontextmanager
async def reached(
    drivers: Drivers, devices: Sequence[DeviceBinding], clock: Clock, tell: Tell
) -> AsyncIterator[list[Found]]:
    """Devices that were all found, in the order of their bindings, as long as the block runs.

    Raises DevicesError with all that is wrong.
    """
    buses = [_Bus(drivers, bus, clock, tell) for bus in by_bus(devices).values()]
    try:
        problems = await asyncio.gather(*(bus.open() for bus in buses))
        if any(problems):
            raise DevicesError([problem for told in problems for problem in told])
        found = {each.name: each for bus in buses for each in bus.found}
        yield [found[device.name] for device in devices]
    finally:
        await asyncio.gather(*(bus.close() for bus in buses))


async def set_up(found: Sequence[Found], kept: Kept, when: str, tell: Tell) -> None:
    """Write what is wrong, after what was there is kept; `when` is now, in words.

    Raises DevicesError with all that could not be written, or is not as it must be in the end.
    """
    meant = [each for each in found if each.wrong]
    problems = await _tried(meant, _check_idle)
    if problems:
        raise DevicesError(problems)
    kept.add([_entry(each, when) for each in meant])
    tell(f"what is there now is kept in {kept.path}; 'lfield setup --back' puts it back")
    problems = await _tried(meant, lambda each: _write(each, tell))
    if problems:
        raise DevicesError(problems)


async def _check_idle(found: Found) -> None:
    found.device.check_idle()


async def _tried(found: Sequence[Found], act: Callable[[Found], Awaitable[None]]) -> list[str]:
    """Do something to each, also when it fails for another; what went wrong, a sentence each."""
    done = await asyncio.gather(*(act(each) for each in found), return_exceptions=True)
    return [
        _problem(each.name, error)
        for each, error in zip(found, done, strict=True)
        if isinstance(error, BaseException)
    ]


def _entry(found: Found, when: str) -> Entry:
    changes = [Change(setting.name, setting.present, setting.wanted) for setting in found.wrong]
    return Entry(when, found.identity, changes, found.device.binding, found.serial)


async def _write(found: Found, tell: Tell) -> None:
    for setting in found.wrong:
        await found.device.write_setting(setting.name, setting.wanted)
        tell(f"{found.name}: {setting.name} was {setting.present:.9g} and is now {setting.wanted:.9g}")
    await found.device.check_settings()

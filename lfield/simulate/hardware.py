"""Simulated hardware of any kind on virtual time, with driver and guard; records every command.

Models only which process commands a device, and when. A device moves during a command, and after a setpoint
until the next command or a watchdog time-out.
"""

from __future__ import annotations

import asyncio
import itertools
import random
from collections.abc import Mapping, Sequence
from inspect import Parameter, Signature
from typing import Any, NamedTuple

from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import RELEASE
from lfield.driver.device import Device, Driver, method_name
from lfield.driver.driver_index import ManifestFile
from lfield.driver.plugin import Plugin, load_plugin
from lfield.errors import DeviceError
from lfield.guard.endpoint_lock import endpoint_targets
from lfield.guard.shell import Shell
from lfield.manifest import DeviceManifest, DeviceValue, Instruction
from lfield.simulate.computers.event_queue import EventQueue
from lfield.simulate.computers.process_loop import ProcessLoop
from lfield.simulate.computers.simulated_computer import Input, SimulatedProcess

#: Module of the driver for simulated hardware.
REFERENCE = "lfield.simulate.hardware:PLUGIN"
#: Seconds until an answer, for a command, and for reaching a safe state.
ANSWER, ACT, STOP = (0.002, 0.02), (0.1, 3.0), (0.05, 0.6)
#: Seconds between two heartbeats of a driver.
FEED = 0.1
#: Seconds to wait for the previous owner's guard, as for the lock of an endpoint.
PATIENCE = 5.0
#: Answer of a query, by L type.
VALUES: Mapping[str, DeviceValue] = {
    "boolean": True, "int": 1, "real": 1.0, "string": "", "real[]": [0.0, 0.0, 0.0], "int[]": [0],
}  # fmt: skip


class DeviceCommand(NamedTuple):
    """A command received by a device: true time, opening that sent it, name."""

    at: float
    owner: int
    what: str
    arguments: tuple[object, ...] = ()
    #: Whether the command leads to a safe state and is not one of a program.
    safe: bool = False


class Hardware:
    """One bus with its devices, independent of its opener."""

    def __init__(self, timeline: EventQueue, rng: random.Random) -> None:
        self._timeline, self.rng = timeline, rng
        self.record: list[DeviceCommand] = []
        #: The open handles, each with the loop of its process.
        self._openings: dict[int, asyncio.AbstractEventLoop] = {}
        self._watchdog = 1.0
        self._fed = self._until = float("-inf")

    def feed(self, watchdog: float = 0.0) -> None:
        """Handles a heartbeat. With a time, that is the watchdog's time-out from now on. A stopped device
        stays stopped.
        """
        if not self.is_moving:
            self._until = float("-inf")
        self._watchdog, self._fed = watchdog or self._watchdog, self._timeline.now

    def command(
        self, owner: int, name: str, arguments: tuple[object, ...], seconds: float, *, safe: bool = False
    ) -> None:
        """Execute a command, moving for that long; `safe`: the command leads to a safe state."""
        self.feed()
        self.record.append(DeviceCommand(self._timeline.now, owner, name, arguments, safe))
        self._until = self._timeline.now + seconds

    @property
    def owners(self) -> list[int]:
        """The open handles of live processes: at most one at a time."""
        return [owner for owner, loop in self._openings.items() if not getattr(loop, "dead", False)]

    def on_opened(self, owner: int) -> None:
        """Records a driver that has opened the bus."""
        self._openings[owner] = asyncio.get_running_loop()

    def on_closed(self, owner: int) -> None:
        """Records a driver that has closed the bus."""
        self._openings.pop(owner, None)

    @property
    def is_moving(self) -> bool:
        now = self._timeline.now
        return now < self._until and now < self._fed + self._watchdog


_OWNERS = itertools.count(1)


class AnyDriver(Driver):
    """The driver of any device type."""

    def _set_up(self) -> None:
        self.hardware, self.owner = _plugged_in(self.endpoint), next(_OWNERS)
        self._feeding = True

    def _device(self, binding: DeviceBinding) -> AnyDevice:
        manifest = self.manifests[binding.type]
        kind = type(binding.type, (AnyDevice,), _methods(manifest.device))
        device: AnyDevice = kind(self, binding, manifest, self.clock, self.reports)
        return device

    async def _open(self) -> None:
        end = self.clock.monotonic() + PATIENCE
        while self.hardware.owners:
            if self.clock.monotonic() > end:
                raise DeviceError(self.bindings[0].field, "another guard has it")
            await asyncio.sleep(FEED)
        self.hardware.on_opened(self.owner)
        self.spawn(self._feed())

    async def _close(self) -> None:
        self.hardware.on_closed(self.owner)

    async def _feed(self) -> None:
        while True:
            if self._feeding:
                self.hardware.feed()
                for device in self.devices.values():
                    device.heard()
            for device in self.devices.values():
                device.publish(**{q.name: VALUES[q.type] for q in device.manifest.device.telemetry})
            await asyncio.sleep(FEED)

    def _quiet(self) -> None:
        self._feeding = False

    def _resume(self) -> None:
        self._feeding = True


class AnyDevice(Device):
    """A device of any type."""

    def __init__(self, driver: AnyDriver, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._driver, self._hardware = driver, driver.hardware

    async def carry_out(self, instruction: Instruction, arguments: Sequence[object]) -> DeviceValue:
        """Executes any instruction."""
        answer = self._hardware.rng.uniform(*ANSWER)
        if not instruction.only_asks:
            # A command is written at once: only its answer is delayed.
            seconds = self._hardware.rng.uniform(*ACT) if instruction.blocking else float("inf")
            self._hardware.command(self._driver.owner, instruction.name, tuple(arguments), seconds)
            answer += seconds if instruction.blocking else 0.0
        await asyncio.sleep(answer)
        return VALUES.get(instruction.result)

    async def _duration(self, seconds: tuple[float, float]) -> None:
        await asyncio.sleep(self._hardware.rng.uniform(*seconds))

    async def _open(self) -> str:
        await self._duration(ANSWER)
        return f"a simulated {self.binding.type}"

    async def _set_watchdog(self, longest: float) -> float | None:
        await self._duration(ANSWER)
        self._hardware.feed(longest)
        return longest

    async def _make_safe(self, state: str) -> None:
        self._hardware.command(self._driver.owner, state, (), self._hardware.rng.uniform(*STOP), safe=True)
        await self._duration(ANSWER)

    def _moving(self) -> str:
        return "moving" if self._hardware.is_moving else ""


def _methods(manifest: DeviceManifest) -> dict[str, Any]:
    """A coroutine per instruction, under the names that the guard looks up."""
    return {
        method_name(i.name): _method(i)
        for i in manifest.instructions
        if not i.is_query and i.name != RELEASE.name
    }


def _method(instruction: Instruction) -> Any:
    """A coroutine whose signature has the parameters of its instruction."""

    async def method(device: AnyDevice, *arguments: object) -> DeviceValue:
        return await device.carry_out(instruction, arguments)

    parameters = [
        Parameter(f"p{n}", Parameter.POSITIONAL_ONLY) for n in range(len(instruction.parameters) + 1)
    ]
    method.__signature__ = Signature(parameters)  # type: ignore[attr-defined]  # as `inspect` documents
    return method


def _plugged_in(endpoint: str) -> Hardware:
    """The hardware at an endpoint of the machine on which this runs."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, ProcessLoop)
    found = loop.machine.hardware[endpoint]
    assert isinstance(found, Hardware)
    return found


class AnyPlugin(Plugin):
    """The plugin of a driver that has every contract."""

    def has_manifest(self, file: ManifestFile) -> bool:
        """See `Plugin`."""
        return True


PLUGIN = AnyPlugin("simulated", "lfield.simulate", "lfield.simulate.hardware:AnyDriver", "all")


class SimulatedLock:
    """The simulated endpoint lock of guards: its owner is a live process."""

    def __init__(self, process: SimulatedProcess) -> None:
        self._loop, self._owned = process.loop, process.computer.network.ports_in_use

    async def acquire(self, endpoint: str) -> None:
        """Acquire all buses of an endpoint. Raises DeviceError."""
        end = self._loop.time() + PATIENCE
        for place in map(str, endpoint_targets(endpoint)):
            while (owner := self._owned.get(place)) is not None and not owner.dead:
                if self._loop.time() > end:
                    raise DeviceError("endpoint", f"{endpoint} is in use by another guard")
                await asyncio.sleep(FEED)
            self._owned[place] = self._loop

    def release(self) -> None:
        for place in [place for place, owner in self._owned.items() if owner is self._loop]:
            del self._owned[place]


def guard(process: SimulatedProcess, arguments: Sequence[str], output: asyncio.WriteTransport) -> Input:
    """The equivalent of `python -m lfield.guard.process PLUGIN`, over simulated pipes."""
    shell = Shell(load_plugin(arguments[0]), output, process.loop.clock, lock=SimulatedLock(process))

    async def serve() -> None:
        status = await shell.exit
        await shell.close()
        process.exit(status)

    process.loop.create_task(serve())

    def on_data(data: bytes | None) -> None:
        if data is None:
            shell.connection_lost(None)
        else:
            shell.data_received(data)

    return on_data

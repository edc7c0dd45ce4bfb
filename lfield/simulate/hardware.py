"""Hardware of any kind on virtual time, with its driver and guard: it does as told, and keeps a record.

What a device is does not matter here, only who commands it when. It moves while a command is carried out, and
after a setpoint until it is told otherwise, or until nobody has fed its watchdog for too long.
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
from lfield.driver.plugin import Plugin, load_plugin
from lfield.errors import DeviceError
from lfield.guard.endpoint_lock import places
from lfield.guard.shell import Shell
from lfield.manifest import DeviceManifest, DeviceValue, Instruction
from lfield.simulate.computers.computer import Input, Process
from lfield.simulate.computers.loop import ProcessLoop
from lfield.simulate.computers.timeline import Timeline

#: Where the driver of simulated hardware is.
REFERENCE = "lfield.simulate.hardware:PLUGIN"
#: Seconds that an answer takes, a command takes to be carried out, and the way into a safe state.
ANSWER, ACT, STOP = (0.002, 0.02), (0.1, 3.0), (0.05, 0.6)
#: Seconds between two signs of life of a driver.
FEED = 0.1
#: Seconds to wait for the guard that had it before, as for the lock of an endpoint.
PATIENCE = 5.0
#: What a query answers, by L type.
VALUES: Mapping[str, DeviceValue] = {
    "boolean": True, "int": 1, "real": 1.0, "string": "", "real[]": [0.0, 0.0, 0.0], "int[]": [0],
}  # fmt: skip


class Told(NamedTuple):
    """What a device was told: when in true time, by which opening of it, and what."""

    at: float
    owner: int
    what: str
    arguments: tuple[object, ...] = ()
    #: Whether it is the way into a safe state, and no command of a program.
    safe: bool = False


class Hardware:
    """One bus with its devices, as it is whoever opens it."""

    def __init__(self, timeline: Timeline, dice: random.Random) -> None:
        self._timeline, self.dice = timeline, dice
        self.record: list[Told] = []
        #: The openings of it that are not closed, each with the loop of its process.
        self._openings: dict[int, asyncio.AbstractEventLoop] = {}
        self._watchdog = 1.0
        self._fed = self._until = float("-inf")

    def feed(self, watchdog: float = 0.0) -> None:
        """A sign of life; with a time, that is its watchdog's from now on. Where it has stopped it stays."""
        if not self.moving:
            self._until = float("-inf")
        self._watchdog, self._fed = watchdog or self._watchdog, self._timeline.now

    def tell(
        self, owner: int, what: str, arguments: tuple[object, ...], seconds: float, *, safe: bool = False
    ) -> None:
        """Carry out a command, for which it moves so long; `safe`: it is the way into a safe state."""
        self.feed()
        self.record.append(Told(self._timeline.now, owner, what, arguments, safe))
        self._until = self._timeline.now + seconds

    @property
    def owners(self) -> list[int]:
        """The openings of it whose process lives: never two at a time."""
        return [owner for owner, loop in self._openings.items() if not getattr(loop, "dead", False)]

    def opened(self, owner: int) -> None:
        """Somebody has it now."""
        self._openings[owner] = asyncio.get_running_loop()

    def closed(self, owner: int) -> None:
        """And has it no longer."""
        self._openings.pop(owner, None)

    @property
    def moving(self) -> bool:
        """Whether it moves now."""
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
        made: AnyDevice = kind(self, binding, manifest, self.clock, self.reports)
        return made

    async def _open(self) -> None:
        end = self.clock.monotonic() + PATIENCE
        while self.hardware.owners:
            if self.clock.monotonic() > end:
                raise DeviceError(self.bindings[0].field, "another guard has it")
            await asyncio.sleep(FEED)
        self.hardware.opened(self.owner)
        self.spawn(self._feed())

    async def _close(self) -> None:
        self.hardware.closed(self.owner)

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

    def __init__(self, driver: AnyDriver, *given: Any) -> None:
        super().__init__(*given)
        self._driver, self._hardware = driver, driver.hardware

    async def carry_out(self, instruction: Instruction, arguments: Sequence[object]) -> DeviceValue:
        """Any instruction."""
        answer = self._hardware.dice.uniform(*ANSWER)
        if not instruction.only_asks:
            # A command is written at once: only its answer takes time.
            seconds = self._hardware.dice.uniform(*ACT) if instruction.blocking else float("inf")
            self._hardware.tell(self._driver.owner, instruction.name, tuple(arguments), seconds)
            answer += seconds if instruction.blocking else 0.0
        await asyncio.sleep(answer)
        return VALUES.get(instruction.result)

    async def _takes(self, seconds: tuple[float, float]) -> None:
        await asyncio.sleep(self._hardware.dice.uniform(*seconds))

    async def _open(self) -> str:
        await self._takes(ANSWER)
        return f"a simulated {self.binding.type}"

    async def _set_watchdog(self, longest: float) -> float | None:
        await self._takes(ANSWER)
        self._hardware.feed(longest)
        return longest

    async def _make_safe(self, state: str) -> None:
        self._hardware.tell(self._driver.owner, state, (), self._hardware.dice.uniform(*STOP), safe=True)
        await self._takes(ANSWER)

    def _moving(self) -> str:
        return "moving" if self._hardware.moving else ""


def _methods(manifest: DeviceManifest) -> dict[str, Any]:
    """A coroutine for each instruction, as the guard looks for them."""
    return {
        method_name(i.name): _method(i)
        for i in manifest.instructions
        if not i.is_query and i.name != RELEASE.name
    }


def _method(instruction: Instruction) -> Any:
    """One that says of itself that it takes as many parameters as its instruction."""

    async def method(device: AnyDevice, *arguments: object) -> DeviceValue:
        return await device.carry_out(instruction, arguments)

    taken = [Parameter(f"p{n}", Parameter.POSITIONAL_ONLY) for n in range(len(instruction.parameters) + 1)]
    method.__signature__ = Signature(taken)  # type: ignore[attr-defined]
    return method


def _plugged_in(endpoint: str) -> Hardware:
    """What stands at an endpoint of the machine that this runs on."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, ProcessLoop)
    found = loop.machine.hardware[endpoint]
    assert isinstance(found, Hardware)
    return found


PLUGIN = Plugin("simulated", "lfield.simulate", "lfield.simulate.hardware:AnyDriver", "all")


class Lock:
    """What an endpoint's lock is to guards, in a simulation: who has it is a process that lives."""

    def __init__(self, process: Process) -> None:
        self._loop, self._taken = process.loop, process.computer.network.taken

    async def take(self, endpoint: str) -> None:
        """Own all that an endpoint leads to. Raises DeviceError."""
        end = self._loop.time() + PATIENCE
        for place in map(str, places(endpoint)):
            while (owner := self._taken.get(place)) is not None and not owner.dead:
                if self._loop.time() > end:
                    raise DeviceError("endpoint", f"{endpoint} is in use by another guard")
                await asyncio.sleep(FEED)
            self._taken[place] = self._loop

    def release(self) -> None:
        """Give everything back."""
        for place in [place for place, owner in self._taken.items() if owner is self._loop]:
            del self._taken[place]


def guard(process: Process, arguments: Sequence[str], output: asyncio.WriteTransport) -> Input:
    """What `python -m lfield.guard.process PLUGIN` does, around the pipes of a simulation."""
    shell = Shell(load_plugin(arguments[0]), output, process.loop.clock, lock=Lock(process))

    async def serve() -> None:
        status = await shell.exit
        await shell.close()
        process.exit(status)

    process.loop.create_task(serve())

    def came(data: bytes | None) -> None:
        if data is None:
            shell.connection_lost(None)
        else:
            shell.data_received(data)

    return came

"""A bench for drivers: a driver with a fake at the other end of its wire, for the tests of its author.

In memory, without a guard, on time that jumps over every wait:

    fake = FakeLamp()
    make = partial(LampDriver, connect=fake.connect)
    bench = DriverBench(PLUGIN, bind(PLUGIN, "Lamp"), make=make, fakes=[fake.live])

    async def story(lamp):
        await lamp.execute("moveTo", [0.5])
        assert bench.values["value"] == 0.5

    bench.run(story)

As processes, in real time, the driver behind its guard as a host has it:

    async def story():
        with running_fake("lamp") as fake:
            async with guarded(bind(PLUGIN, "Lamp", endpoint=fake.endpoint)) as (lamp,):
                fake.fault("stuck=true")
                await lamp.call("moveTo", 0.5)

    asyncio.run(story())
"""

from __future__ import annotations

import asyncio
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager
from functools import cache
from typing import Any, TypeVar

from lfield import loop
from lfield.clock import Clock, SystemClock
from lfield.devices.guards import Guards
from lfield.devices.try_out import LiveBench
from lfield.driver import DeviceBinding, Driver, Manifest, Plugin, Reports
from lfield.driver.binding import OptionValue
from lfield.driver.plugins import Plugins, discover
from lfield.driver.sims import control_doors, discover_sims
from lfield.net.control import ask_fake
from lfield.simulate.time import LoopClock, run_jumping
from lfield.testing.reports import KeptReports

T = TypeVar("T")

#: Makes a driver: its class, or the class with what joins it to a fake.
MakeDriver = Callable[[Sequence[DeviceBinding], Mapping[str, Manifest], Clock, Reports], Driver]
#: What a test does with the devices of a bench.
Story = Callable[..., Awaitable[T]]

#: Seconds that a story may take: of jumping time, and of real time.
LONGEST, LONGEST_REAL = 1e6, 60.0
#: Seconds that something may take to happen, unless a test says otherwise, and between two looks.
BOUND, LOOK = 20.0, 0.01
#: Seconds for a fake to end.
END = 20.0
#: How long a host may be silent, in seconds: longer than on a robot, since a test's computer may be busy.
SILENCE = 2.0


def bind(
    plugin: Plugin, device_type: str = "", *, options: Mapping[str, OptionValue] | None = None, **given: Any
) -> DeviceBinding:
    """A binding of a plugin's device with all that its manifest gives by default.

    `device_type` may be left out where the plugin has one only. `options` are those that the test sets, and
    `given` any other fields of a DeviceBinding. Raises KeyError for a device type that it has not.
    """
    manifests = _manifests(plugin)
    manifest = manifests[device_type or next(iter(manifests))]
    defaults = {option.name: option.default for option in manifest.options if option.default is not None}
    fields: dict[str, Any] = {
        "agent": "bench",
        "field": "device",
        "endpoint": "memory:",
        "safe_state": manifest.default_safe_state,
        **given,
    }
    return DeviceBinding(
        type=manifest.device.type, driver=plugin.name, options={**defaults, **(options or {})}, **fields
    )


@cache
def _manifests(plugin: Plugin) -> dict[str, Manifest]:
    return plugin.read_manifests()


class DriverBench(KeptReports):
    """A driver with its devices, without a guard; keeps what they report. Whatever crashes fails the test.

    `make` makes the driver, by default its class: a test gives what joins it to a fake in memory. Each of
    `fakes` is a coroutine function that runs beside the driver, from before it opens until it is closed.
    """

    #: Of the story that runs, or ran last.
    driver: Any

    def __init__(
        self,
        plugin: Plugin,
        *bindings: DeviceBinding,
        make: MakeDriver | None = None,
        fakes: Sequence[Callable[[], Coroutine[Any, Any, None]]] = (),
    ) -> None:
        super().__init__(*(binding.name for binding in bindings))
        self.bindings = bindings
        self._manifests, self._make, self._fakes = _manifests(plugin), make or plugin.load(), fakes

    def run(self, story: Story[T], *, opened: bool = True, within: float = LONGEST) -> T:
        """`play` on jumping time, so that hours take milliseconds; the bench has a loop of its own."""
        return run_jumping(self.play(story, LoopClock(), opened=opened, within=within))

    def run_real(self, story: Story[T], *, opened: bool = True, within: float = LONGEST_REAL) -> T:
        """`play` in real time, on the loop of a guard: for fakes that are processes, and for threads."""
        return loop.run(self.play(story, SystemClock(), opened=opened, within=within))

    async def play(
        self, story: Story[T], clock: Clock, *, opened: bool = True, within: float = LONGEST_REAL
    ) -> T:
        """Make the driver, open it, run `story(*devices)`, close it; what the story returns.

        The devices are open unless `opened` is False. Raises what the story raises, TimeoutError after
        `within` seconds, AssertionError when something crashed meanwhile.
        """
        self.driver = self._make(self.bindings, self._manifests, clock, self)
        beside = [asyncio.ensure_future(self._live(fake)) for fake in self._fakes]
        try:
            async with asyncio.timeout(within):
                # The fakes are there before the driver looks for them.
                await asyncio.sleep(0)
                result = await self._tell(story, opened)
        except BaseException as error:
            for crash in self.crashes:
                error.add_note(f"meanwhile: {crash}")
            raise
        finally:
            for task in beside:
                task.cancel()
            await self.driver.close()
        if self.crashes:
            raise AssertionError(f"broken meanwhile: {'; '.join(self.crashes)}")
        return result

    async def _tell(self, story: Story[T], opened: bool) -> T:
        await self.driver.open()
        devices = tuple(self.driver.devices.values())
        if opened:
            await asyncio.gather(*(device.open() for device in devices))
        return await story(*devices)

    async def _live(self, fake: Callable[[], Coroutine[Any, Any, None]]) -> None:
        try:
            await fake()
        except Exception as error:  # nobody waits for it
            self.crashed(f"the fake: {error!r}")

    async def until(self, condition: Callable[[], bool], bound: float = BOUND) -> None:
        """Let time pass until the condition holds. Raises AssertionError after `bound` seconds."""
        running = asyncio.get_running_loop()
        end = running.time() + bound
        while not condition():
            if running.time() >= end:
                raise AssertionError(f"it was not so within {bound:g} s: {self.reported}, {self.notes}")
            await asyncio.sleep(LOOK)


class RunningFake:
    """A fake in a process of its own. `words` is what it said when it was ready: its endpoints first."""

    def __init__(self, driver: str, process: subprocess.Popen[str], words: Sequence[str]) -> None:
        self._driver, self.process, self.words = driver, process, words

    @property
    def endpoint(self) -> str:
        """Where it answers, as a binding has it."""
        return self.words[0]

    def fault(self, *settings: str) -> dict[str, Any]:
        """Set what is wrong with it, `NAME[@DEVICE]=VALUE`; its answer. Raises AssertionError."""
        name = f"{self._driver}-{self.process.pid}.sock"
        answer = ask_fake(next(door for door in control_doors() if door.name == name), settings)
        if "error" in answer:
            raise AssertionError(answer["error"])
        return answer


@contextmanager
def running_fake(driver: str, *options: str) -> Iterator[RunningFake]:
    """The installed fake of a driver, with options of `lfield sim DRIVER`; it ends with the block."""
    command = (sys.executable, "-P", "-m", "lfield.driver.sims", discover_sims().references[driver])
    with tempfile.TemporaryFile("w+", errors="replace") as errors:
        process = subprocess.Popen(
            [*command, *options, "--until-stdin-closes"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
        )
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            if not line.startswith("ready "):
                process.wait(END)
                errors.seek(0)
                last = [*line.splitlines(), *errors.read().splitlines(), "nothing"][-2:][0]
                raise AssertionError(f"the fake '{driver}' did not start; it said: {last}")
            yield RunningFake(driver, process, line.split()[1:])
        finally:
            process.communicate(timeout=END)
            errors.seek(0)
            sys.stderr.write(errors.read())
    if process.returncode:
        raise AssertionError(f"the fake '{driver}' ended with status {process.returncode}")


class GuardedDevice(LiveBench):
    """A device behind its guard: called, queried and made safe as in a check of the conformance kit."""

    async def told(self, words: str, bound: float = BOUND) -> None:
        """Wait until a note of the guards has these words. Raises CheckFailed."""
        await self.until(lambda: any(words in note for note in self.notes), bound, f"the note '{words}'")

    async def reads(self, quantity: str, fits: Callable[[Any], bool], bound: float = BOUND) -> Any:
        """Wait until a quantity of its telemetry has a value that fits; that value. Raises CheckFailed."""
        await self.until(lambda: fits(self.query(quantity)), bound, f"{quantity} to fit")
        return self.query(quantity)


@asynccontextmanager
async def guarded(
    *bindings: DeviceBinding,
    plugins: Plugins | None = None,
    silence: float = SILENCE,
    clock: Clock | None = None,
) -> AsyncIterator[tuple[GuardedDevice, ...]]:
    """Devices behind guards in processes of their own, in the order of their bindings; closed with the block.

    `plugins` are the drivers, by default those that are installed, and `clock` is that of the loop, the
    system's by default. Raises DevicesError.
    """
    drivers, notes = plugins or discover(), list[str]()
    guards = Guards(drivers, clock or SystemClock(), notes.append, silence=silence)
    await guards.open(bindings)
    try:
        yield tuple(
            GuardedDevice(guards, b, drivers.by_driver[b.driver].manifests[b.type], notes, silence=silence)
            for b in bindings
        )
    finally:
        await guards.close()

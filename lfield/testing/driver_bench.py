"""A test bench for driver authors: a driver connected to a fake.

In memory, without a guard, on virtual time:

    fake = FakeLamp()
    make = partial(LampDriver, connect=fake.connect)
    bench = DriverBench(PLUGIN, bind(PLUGIN, "Lamp"), make=make, fakes=[fake.live])

    async def scenario(lamp):
        await lamp.execute("moveTo", [0.5])
        assert bench.values["value"] == 0.5

    bench.run(scenario)

As processes, in real time, with a guard:

    async def scenario():
        with running_fake("lamp") as fake:
            async with guarded(bind(PLUGIN, "Lamp", endpoint=fake.endpoint)) as (lamp,):
                fake.fault("stuck=true")
                await lamp.call("moveTo", 0.5)

    asyncio.run(scenario())
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

from lfield import event_loop
from lfield.clock import Clock, SystemClock
from lfield.devices.conformance_run import LiveBench
from lfield.devices.device_guards import DeviceGuards
from lfield.driver import DeviceBinding, Driver, Manifest, Plugin, Reports
from lfield.driver.binding import OptionValue
from lfield.driver.plugins import Plugins, discover
from lfield.driver.sims import control_sockets, discover_sims
from lfield.guard.messages import NO_RECORDING, GuardRecording
from lfield.net.fault_client import send_fault_command
from lfield.simulate.jumping_loop import LoopClock, run_jumping
from lfield.testing.kept_reports import KeptReports

T = TypeVar("T")

#: Creates a driver: its class, or a function that connects it to a fake.
MakeDriver = Callable[[Sequence[DeviceBinding], Mapping[str, Manifest], Clock, Reports], Driver]
#: A scenario of a test with the devices of a bench.
Story = Callable[..., Awaitable[T]]

#: Seconds for a scenario: of virtual time, and of real time.
LONGEST, LONGEST_REAL = 1e6, 180.0
#: Default seconds for a condition, and seconds between two checks.
BOUND, POLL_INTERVAL = 60.0, 0.01
#: Seconds for a simulated device to end.
END = 60.0
#: Host time-out in seconds: longer than on a robot, since a test computer may be busy.
SILENCE = 2.0


def bind(
    plugin: Plugin, device_type: str = "", *, options: Mapping[str, OptionValue] | None = None, **fields: Any
) -> DeviceBinding:
    """A binding of a plugin's device with the defaults of its manifest.

    `device_type` may be omitted if the plugin has only one. `options` are those set by the test, `fields` any
    other fields of a DeviceBinding. Raises KeyError for an unknown device type.
    """
    manifests = _manifests(plugin)
    manifest = manifests[device_type or next(iter(manifests))]
    defaults = {option.name: option.default for option in manifest.options if option.default is not None}
    values: dict[str, Any] = {
        "agent": "bench",
        "field": "device",
        "endpoint": "memory:",
        "safe_state": manifest.default_safe_state,
        **fields,
    }
    return DeviceBinding(
        type=manifest.device.type, driver=plugin.name, options={**defaults, **(options or {})}, **values
    )


@cache
def _manifests(plugin: Plugin) -> dict[str, Manifest]:
    return plugin.read_manifests()


class DriverBench(KeptReports):
    """A driver with its devices, without a guard; records their reports. A crash fails the test.

    `make` creates the driver, by default its class: a test passes a function that connects it to a simulated
    device in memory. Each of `fakes` is a coroutine function that runs from before the driver opens until it
    is closed.
    """

    #: The records of the present or last scenario.
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
        """Runs `play` on virtual time, so that hours take milliseconds; the bench has its own loop."""
        return run_jumping(self.play(story, LoopClock(), opened=opened, within=within))

    def run_real(self, story: Story[T], *, opened: bool = True, within: float = LONGEST_REAL) -> T:
        """Runs `play` in real time, on the loop of a guard: for simulated devices that are processes, and for
        threads."""
        return event_loop.run(self.play(story, SystemClock(), opened=opened, within=within))

    async def play(
        self, story: Story[T], clock: Clock, *, opened: bool = True, within: float = LONGEST_REAL
    ) -> T:
        """Creates the driver, opens it, runs `story(*devices)` and closes it; returns the story's result.

        The devices are open unless `opened` is False. Raises the exceptions of the story, TimeoutError after
        `within` seconds, AssertionError after a crash.
        """
        self.driver = self._make(self.bindings, self._manifests, clock, self)
        background = [asyncio.ensure_future(self._live(fake)) for fake in self._fakes]
        try:
            async with asyncio.timeout(within):
                # The simulated devices start before the driver connects.
                await asyncio.sleep(0)
                result = await self._run_story(story, opened)
        except BaseException as error:
            for crash in self.crashes:
                error.add_note(f"meanwhile: {crash}")
            raise
        finally:
            for task in background:
                task.cancel()
            await self.driver.close()
        if self.crashes:
            raise AssertionError(f"failed meanwhile: {'; '.join(self.crashes)}")
        return result

    async def _run_story(self, story: Story[T], opened: bool) -> T:
        await self.driver.open()
        devices = tuple(self.driver.devices.values())
        if opened:
            await asyncio.gather(*(device.open() for device in devices))
        return await story(*devices)

    async def _live(self, fake: Callable[[], Coroutine[Any, Any, None]]) -> None:
        try:
            await fake()
        except Exception as error:  # it is not awaited
            self.crashed(f"the simulated device: {error!r}")

    async def until(self, condition: Callable[[], bool], bound: float = BOUND) -> None:
        """Waits until the condition holds. Raises AssertionError after `bound` seconds."""
        running = asyncio.get_running_loop()
        end = running.time() + bound
        while not condition():
            if running.time() >= end:
                raise AssertionError(
                    f"the condition did not hold within {bound:g} s: {self.reported}, {self.notes}"
                )
            await asyncio.sleep(POLL_INTERVAL)


class RunningFake:
    """A simulated device in its own process. `ready_line` is its output when it was ready, starting with its
    endpoints.
    """

    def __init__(self, driver: str, process: subprocess.Popen[str], ready_line: Sequence[str]) -> None:
        self._driver, self.process, self.ready_line = driver, process, ready_line

    @property
    def endpoint(self) -> str:
        """The endpoint of the device, as in a binding."""
        return self.ready_line[0]

    def fault(self, *settings: str) -> dict[str, Any]:
        """Sets faults, `NAME[@DEVICE]=VALUE`; returns the answer. Raises AssertionError."""
        name = f"{self._driver}-{self.process.pid}.sock"
        answer = send_fault_command(next(path for path in control_sockets() if path.name == name), settings)
        if "error" in answer:
            raise AssertionError(answer["error"])
        return answer


@contextmanager
def running_fake(driver: str, *options: str) -> Iterator[RunningFake]:
    """Runs the installed simulated device of a driver, with options of `lfield sim DRIVER`, for the block."""
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
                raise AssertionError(f"the simulated device '{driver}' did not start; its output: {last}")
            yield RunningFake(driver, process, line.split()[1:])
        finally:
            process.communicate(timeout=END)
            errors.seek(0)
            sys.stderr.write(errors.read())
    if process.returncode:
        raise AssertionError(f"the simulated device '{driver}' ended with status {process.returncode}")


class GuardedDevice(LiveBench):
    """A device behind its guard: called, queried and made safe as in a check of the conformance kit."""

    async def until_note(self, text: str, bound: float = BOUND) -> None:
        """Waits until a log line of the guards contains the text. Raises CheckFailed."""
        await self.until(lambda: any(text in note for note in self.notes), bound, f"the note '{text}'")

    async def reads(self, quantity: str, fits: Callable[[Any], bool], bound: float = BOUND) -> Any:
        """Waits until a quantity has a value that fits; returns it. Raises CheckFailed."""
        await self.until(lambda: fits(self.query(quantity)), bound, f"{quantity} to fit")
        return self.query(quantity)


@asynccontextmanager
async def guarded(
    *bindings: DeviceBinding,
    plugins: Plugins | None = None,
    silence: float = SILENCE,
    clock: Clock | None = None,
    recording: GuardRecording = NO_RECORDING,
) -> AsyncIterator[tuple[GuardedDevice, ...]]:
    """Devices behind guards in their own processes, in the order of their bindings; closed with the block.

    `plugins` are by default the installed drivers, `clock` that of the loop (by default the system's).
    `recording` is the folder that the guards record into, if any. Raises DevicesError.
    """
    drivers, notes = plugins or discover(), list[str]()
    guards = DeviceGuards(drivers, clock or SystemClock(), notes.append, silence=silence)
    await guards.open(bindings, recording)
    try:
        yield tuple(
            GuardedDevice(guards, b, drivers.by_driver[b.driver].manifests[b.type], notes, silence=silence)
            for b in bindings
        )
    finally:
        await guards.close()

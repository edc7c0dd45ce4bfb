"""A test bench on virtual time: drivers behind their guards, and simulated devices on cables, in one process.

The conformance kit of a driver on its own simulated device, in seconds instead of minutes:

    def test_a_lamp_passes_its_kit():
        desk = Desk()
        lamp = desk.fake("lamp", "--fault", "slow=true")
        found = desk.try_kit(bind(PLUGIN, endpoint=lamp.endpoint))
        assert [finding for finding in found if finding.outcome == "failed"] == []

Or a scenario of the test, with devices as of `lfield.testing.driver_bench.guarded`:

    async def scenario(lamp):
        await lamp.call("moveTo", 0.5)
        fake.fault("stuck=true")

    desk.run(scenario, bind(PLUGIN, endpoint=fake.endpoint))

Guards, drivers and simulated devices are the real ones, as in a mission's test: the computer, its processes,
its clock and the cables are a model. One seed is one run.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

from lfield.devices.conformance_run import conformance_checks, run_conformance
from lfield.driver.binding import DeviceBinding
from lfield.driver.kit import Check, Finding
from lfield.driver.plugins import Plugins, discover
from lfield.driver.sims import Sim, discover_sims
from lfield.errors import MissionTestError, PluginError, Stuck
from lfield.event_loop import ServedFake
from lfield.guard.core import HOST_TIMEOUT
from lfield.simulate.computers.event_queue import EventQueue
from lfield.simulate.computers.process_loop import closing_generators, release
from lfield.simulate.computers.simulated_computer import SimulatedComputer, SimulatedProcess
from lfield.simulate.computers.simulated_machine import MachineClock, SimulatedMachine
from lfield.simulate.computers.simulated_network import SimulatedNetwork
from lfield.simulate.hardware import guard
from lfield.testing.cabled_fakes import CabledFake, wait_until_serving
from lfield.testing.driver_bench import guarded
from lfield.testing.mission.io_guard import io_guarded

T = TypeVar("T")

#: Seconds of virtual time for a scenario.
LONGEST = 3600.0
#: Seconds between two checks whether a scenario has ended.
POLL_INTERVAL = 0.02


class DeskFake:
    """A simulated device on the desk, for tests; the counterpart of `lfield.testing.driver_bench.RunningFake`
    in real time.
    """

    def __init__(self, process: SimulatedProcess, fake: ServedFake) -> None:
        self._process, self._fake = process, fake

    @property
    def endpoint(self) -> str:
        """The endpoint of the device, as in a binding."""
        return self._fake.endpoint

    def fault(self, *settings: str) -> None:
        """Sets faults, `NAME[@DEVICE]=VALUE`. Raises MissionTestError."""
        rejections: list[ValueError] = []

        def apply() -> None:
            try:
                self._fake.faults.apply(settings)
            except ValueError as error:
                rejections.append(error)

        with _outside_story():
            self._process.loop.enter(apply)
        if rejections:
            raise MissionTestError(f"the simulated device '{self._fake.kind}': {rejections[0]}")

    def facts(self, device: str = "") -> Mapping[str, str | int | bool]:
        """True values of a device, by its id or of the only one, independent of the wire."""
        return self._fake.facts[device or next(iter(self._fake.facts))]()


class Desk:
    """One computer with the devices connected to it. `plugins` are by default the installed ones."""

    def __init__(self, *, plugins: Plugins | None = None, seed: int = 0) -> None:
        self._plugins = plugins or discover()
        rng = random.Random(seed)
        self._timeline = EventQueue()
        machine = SimulatedMachine("desk", self._timeline, random.Random(rng.random()))
        self._network = SimulatedNetwork(self._timeline, {machine.name: machine}, rng)
        self._computer = SimulatedComputer(machine, self._network, {"lfield.guard.process": guard})
        self._fakes: list[CabledFake] = []

    @property
    def now(self) -> float:
        """Seconds since the desk was created."""
        return self._timeline.now

    @property
    def clock(self) -> MachineClock:
        """The clock of the computer."""
        return self._computer.machine.clock

    def at(self, seconds: float, action: Callable[[], None]) -> None:
        """Runs an action at a time of `now`, while a scenario runs."""
        self._timeline.at(seconds, action)

    def kill(self, pid: int) -> None:
        """Kills a process of the computer: a guard, by `guard_pid` of its device. Raises KeyError."""
        process = {process.pid: process for process in self._computer.processes}[pid]
        self._timeline.after(0.0, partial(process.die, -9))

    def fake(self, sim: str | Sim, *options: str) -> DeskFake:
        """Starts a simulated device, by the name of its driver if it is installed, with options of `lfield
        sim`.

        Raises PluginError and MissionTestError.
        """
        if isinstance(sim, str):
            known = discover_sims()
            if sim not in known:
                available = ", ".join(sorted(known)) or "none"
                raise PluginError(f"there is no simulated device '{sim}' (installed: {available})")
            sim = known[sim]
        name = f"{sim.name}-{len(self._fakes) + 1}"
        with io_guarded() as caught:
            cabled = CabledFake(name, sim, options, self._timeline, self._network)
            serving = wait_until_serving({name: cabled}, self._timeline)[name]
        for error in caught:
            raise error
        self._fakes.append(cabled)
        return DeskFake(cabled.process, serving)

    def run(
        self,
        story: Callable[..., Awaitable[T]],
        *devices: DeviceBinding,
        within: float = LONGEST,
        silence: float = HOST_TIMEOUT,
    ) -> T:
        """Runs `story(*devices)` in a process of the computer, with each device a GuardedDevice; returns its
        result.

        The devices are opened behind guards first and closed at the end. `silence` is the host time-out in
        seconds. Raises the exceptions of the story, DevicesError, and Stuck after `within` seconds.
        """

        async def guarded_story() -> T:
            if not devices:
                return await story()
            async with guarded(*devices, plugins=self._plugins, silence=silence, clock=self.clock) as opened:
                return await story(*opened)

        return self._played(guarded_story(), within)

    def try_kit(
        self,
        *devices: DeviceBinding,
        checks: Iterable[Check] | None = None,
        may_move: bool = True,
        silence: float = HOST_TIMEOUT,
    ) -> list[Finding]:
        """The findings of the conformance kit on devices of one driver, as by `lfield kit`.

        `checks` are by default all: the standard ones and the driver's own. Raises as `run`.
        """
        if checks is None:
            checks = conformance_checks(self._plugins.by_driver[devices[0].driver])
        trying = run_conformance(
            self._plugins, devices, checks, may_move, lambda finding: None, clock=self.clock, silence=silence
        )
        return self._played(trying, LONGEST)

    def close(self) -> None:
        """Ends all processes of the desk and of its simulated devices at once, and frees their memory."""
        computers = [self._computer, *(fake.computer for fake in self._fakes)]
        for computer in computers:
            computer.power_off()
        for computer in computers:
            release(computer.machine)

    def _played(self, story: Awaitable[T], within: float) -> T:
        process, tasks, end = self._computer.start(), list[asyncio.Task[T]](), self.now + within

        async def run_story() -> T:
            return await story

        with io_guarded() as caught, closing_generators():
            process.loop.enter(lambda: tasks.append(process.loop.create_task(run_story())))
            while not tasks[0].done() and self.now < end and not caught:
                self._timeline.run(POLL_INTERVAL)
        self._end(process)
        broken = tasks[0].exception() if tasks[0].done() else None
        for error in (*caught, *(failure for fake in self._fakes for failure in fake.failures)):
            raise error
        if broken is not None:
            raise broken
        if not tasks[0].done():
            raise Stuck(f"the scenario has not ended after {within:g} s of virtual time", [])
        return tasks[0].result()

    def _end(self, process: SimulatedProcess) -> None:
        """Kills the process, with its remaining guards."""
        for each in (process, *process.children):
            each.die(-9)


@contextmanager
def _outside_story() -> Iterator[None]:
    """Leaves the running loop, so that code within does not use it."""
    # asyncio has no public way to leave a loop temporarily; `run_until_complete` of another loop would be
    # refused. Both functions are provided for implementers of event loops.
    running = asyncio._get_running_loop()
    asyncio._set_running_loop(None)
    try:
        yield
    finally:
        asyncio._set_running_loop(running)

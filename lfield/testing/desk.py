"""A desk on virtual time: drivers behind their guards, and fakes on cables, in one process.

The conformance kit of a driver on its own fake, in a second or two instead of a minute or two:

    def test_a_lamp_passes_its_kit():
        desk = Desk()
        lamp = desk.fake("lamp", "--fault", "slow=true")
        found = desk.try_kit(bind(PLUGIN, endpoint=lamp.endpoint))
        assert [finding for finding in found if finding.outcome == "failed"] == []

Or what a test itself does with devices, as `lfield.testing.driver_bench.guarded` has them:

    async def story(lamp):
        await lamp.call("moveTo", 0.5)
        fake.fault("stuck=true")

    desk.run(story, bind(PLUGIN, endpoint=fake.endpoint))

Guards, drivers and fakes are the real ones, as in a mission's test: the computer, its processes, its clock
and the cables are a model. One seed is one run.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

from lfield.devices.try_out import checks_of, try_devices
from lfield.driver.binding import DeviceBinding
from lfield.driver.kit import Check, Finding
from lfield.driver.plugins import Plugins, discover
from lfield.driver.sims import Sim, discover_sims
from lfield.errors import MissionTestError, PluginError, Stuck
from lfield.guard.core import SILENCE
from lfield.loop import Fake
from lfield.simulate.computers.computer import Computer, Process
from lfield.simulate.computers.loop import generators
from lfield.simulate.computers.machines import Machine, MachineClock
from lfield.simulate.computers.network import Network
from lfield.simulate.computers.timeline import Timeline
from lfield.simulate.hardware import guard
from lfield.testing.cables import CabledFake, all_serve
from lfield.testing.driver_bench import guarded
from lfield.testing.mission.fence import fenced

T = TypeVar("T")

#: Seconds of virtual time that a story may take.
LONGEST = 3600.0
#: Seconds between two looks whether a story is over.
LOOK = 0.02


class DeskFake:
    """A fake on the desk, for tests: what `lfield.testing.driver_bench.RunningFake` is in real time."""

    def __init__(self, process: Process, fake: Fake) -> None:
        self._process, self._fake = process, fake

    @property
    def endpoint(self) -> str:
        """Where it answers, as a binding has it."""
        return self._fake.endpoint

    def fault(self, *settings: str) -> None:
        """Let something be wrong from now on, `NAME[@DEVICE]=VALUE`. Raises MissionTestError."""
        wrong: list[ValueError] = []

        def apply() -> None:
            try:
                self._fake.faults.apply(settings)
            except ValueError as error:
                wrong.append(error)

        with _beside_the_story():
            self._process.loop.enter(apply)
        if wrong:
            raise MissionTestError(f"the fake '{self._fake.kind}': {wrong[0]}")

    def facts(self, device: str = "") -> Mapping[str, str | int | bool]:
        """What is true of a device now, by its id or the only one, whatever the wire says."""
        return self._fake.facts[device or next(iter(self._fake.facts))]()


class Desk:
    """One computer with what stands on the desk beside it. `plugins` are by default those installed."""

    def __init__(self, *, plugins: Plugins | None = None, seed: int = 0) -> None:
        self._plugins = plugins or discover()
        dice = random.Random(seed)
        self._timeline = Timeline()
        machine = Machine("desk", self._timeline, random.Random(dice.random()))
        self._network = Network(self._timeline, {machine.name: machine}, dice)
        self._computer = Computer(machine, self._network, {"lfield.guard.process": guard})
        self._fakes: list[CabledFake] = []

    @property
    def now(self) -> float:
        """Seconds since the desk was set up."""
        return self._timeline.now

    @property
    def clock(self) -> MachineClock:
        """The clock of its computer."""
        return self._computer.machine.clock

    def at(self, seconds: float, action: Callable[[], None]) -> None:
        """Do something at a moment of `now`, while a story runs."""
        self._timeline.at(seconds, action)

    def kill(self, pid: int) -> None:
        """End a process of its computer by force: a guard, by `guard_pid` of its device. Raises KeyError."""
        process = {process.pid: process for process in self._computer.processes}[pid]
        self._timeline.after(0.0, partial(process.die, -9))

    def fake(self, sim: str | Sim, *options: str) -> DeskFake:
        """A fake, by the name of its driver where it is installed, with options of `lfield sim`.

        Raises PluginError and MissionTestError.
        """
        if isinstance(sim, str):
            known = discover_sims()
            if sim not in known:
                there = ", ".join(sorted(known)) or "none"
                raise PluginError(f"there is no fake '{sim}' (fakes installed: {there})")
            sim = known[sim]
        name = f"{sim.name} {len(self._fakes) + 1}"
        with fenced() as caught:
            cabled = CabledFake(name, sim, options, self._timeline, self._network)
            serving = all_serve({name: cabled}, self._timeline)[name]
        for error in caught:
            raise error
        self._fakes.append(cabled)
        return DeskFake(cabled.process, serving)

    def run(
        self,
        story: Callable[..., Awaitable[T]],
        *devices: DeviceBinding,
        within: float = LONGEST,
        silence: float = SILENCE,
    ) -> T:
        """Run `story(*devices)` in a process of the computer, each device a GuardedDevice; what it returns.

        The devices are opened behind guards first, and closed in the end. `silence` is how long the host may
        be silent, in seconds. Raises what the story raises, DevicesError, and Stuck after `within` seconds.
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
        silence: float = SILENCE,
    ) -> list[Finding]:
        """The findings of the conformance kit on devices of one driver, as `lfield kit` makes them.

        `checks` are by default all: those of every driver and the driver's own. Raises as `run`.
        """
        if checks is None:
            checks = checks_of(self._plugins.by_driver[devices[0].driver])
        trying = try_devices(
            self._plugins, devices, checks, may_move, lambda finding: None, clock=self.clock, silence=silence
        )
        return self._played(trying, LONGEST)

    def _played(self, story: Awaitable[T], within: float) -> T:
        process, told, end = self._computer.start(), list[asyncio.Task[T]](), self.now + within

        async def begin() -> T:
            return await story

        with fenced() as caught, generators():
            process.loop.enter(lambda: told.append(process.loop.create_task(begin())))
            while not told[0].done() and self.now < end and not caught:
                self._timeline.run(LOOK)
        self._end(process)
        broken = told[0].exception() if told[0].done() else None
        for error in (*caught, *(trouble for fake in self._fakes for trouble in fake.trouble)):
            raise error
        if broken is not None:
            raise broken
        if not told[0].done():
            raise Stuck(f"the story was not over after {within:g} s of virtual time", [])
        return told[0].result()

    def _end(self, process: Process) -> None:
        """As SIGKILL, with the guards that it has left."""
        for each in (process, *process.children):
            each.die(-9)


@contextmanager
def _beside_the_story() -> Iterator[None]:
    """What is done meanwhile is done by nobody on the desk: no loop runs that could be taken for its own."""
    # asyncio has no public way to leave a loop for a moment; `run_until_complete` of another loop would be
    # refused by the same mark. Both functions are there for those who write event loops, as we do.
    running = asyncio._get_running_loop()
    asyncio._set_running_loop(None)
    try:
        yield
    finally:
        asyncio._set_running_loop(running)

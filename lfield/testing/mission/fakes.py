"""The fakes of a mission under test, on virtual time: each bus stands on a cable beside its robot's computer.

A fake is a process of its own machine: it goes on whatever becomes of the computer, as hardware does.
"""

from __future__ import annotations

import argparse
import random
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from lfield.devices.fakes import conditions
from lfield.driver.binding import DeviceBinding
from lfield.driver.sims import Sim, SimOnLoop, sims_of
from lfield.errors import LfieldError, MissionTestError, PluginError
from lfield.loop import Fake
from lfield.mission.mission import Mission
from lfield.simulate.computers.computer import Computer, Process
from lfield.simulate.computers.machines import Machine
from lfield.simulate.fleet import Fleet, at_endpoints, buses_of

#: Seconds for all fakes to be ready, and how often to look.
READY, LOOK = 5.0, 0.01

Place = tuple[float, float, float]
#: Host, driver and endpoint.
Bus = tuple[str, str, str]


class FakeDevice:
    """One device of a fake, as a test has it."""

    def __init__(
        self, name: str, process: Process, fake: Fake, number: str, mark: Callable[[str, str], None]
    ) -> None:
        self.name = name
        self._process, self._fake, self._number, self._mark = process, fake, number, mark

    def set(self, *faults: str) -> None:
        """Let something be wrong from now on: `set("battery=0.2", "motor_failure=true")`.

        Raises MissionTestError for what this fake does not know.
        """
        wrong: list[ValueError] = []
        named = [_at(text, self._number) for text in faults]

        def apply() -> None:
            try:
                self._fake.faults.apply(named)
            except ValueError as error:
                wrong.append(error)

        self._process.loop.enter(apply)
        if wrong:
            raise MissionTestError(f"{self.name}: {wrong[0]}")
        self._mark(f"{self.name}: {', '.join(faults)}", self.name)

    @property
    def facts(self) -> Mapping[str, str | int | bool]:
        """What is true of it now, whatever the wire says: `facts["mode"]`. Empty where it tells none."""
        tell = self._fake.facts.get(self._number)
        return tell() if tell else {}

    @property
    def place(self) -> Place | None:
        """Where it is: metres north, east and up of where fakes are switched on; None where it tells none."""
        tell = self._fake.places.get(self._number)
        return tell() if tell else None


def _at(text: str, number: str) -> str:
    name, equals, value = text.partition("=")
    return text if "@" in name else f"{name}@{number}{equals}{value}"


class Fakes:
    """All fakes of a mission. `wrong` are faults from the start, by the names of devices.

    `mark` is told of faults that are set later: in words, and the device.
    """

    def __init__(
        self, wrong: Mapping[str, Sequence[str]], mark: Callable[[str, str], None] = lambda words, name: None
    ) -> None:
        self._wrong, self._mark = wrong, mark
        self._problems: list[str] = []
        #: What fakes have raised that they should not.
        self.trouble: list[Exception] = []
        self._served: dict[Bus, tuple[Process, Fake]] = {}
        #: By the names of their bindings.
        self.devices: dict[str, FakeDevice] = {}

    def plug(self, fleet: Fleet, mission: Mission, _: random.Random) -> Mission:
        """Start them, and give the mission with their endpoints. Raises PluginError and MissionTestError."""
        buses = buses_of(mission)
        names = {device.name for bus in buses.values() for device in bus}
        if unknown := sorted(self._wrong.keys() - names):
            known = ", ".join(sorted(names)) or "none"
            raise MissionTestError(f"there is no device '{unknown[0]}' with a fake here; there are: {known}")
        sims = sims_of({driver for _, driver, _ in buses})
        for bus, devices in buses.items():
            if (sim := sims.get(bus[1])) is None:
                raise PluginError(f"{devices[0].name}: there is no fake for driver '{bus[1]}'")
            self._start(fleet, bus, devices, sim)
        self._wait(fleet, buses)
        endpoints = {bus: fake.endpoint for bus, (_, fake) in self._served.items()}
        return at_endpoints(
            mission, {d.name: endpoints[bus] for bus, devices in buses.items() for d in devices}
        )

    def _start(self, fleet: Fleet, bus: Bus, devices: Sequence[DeviceBinding], sim: Sim) -> None:
        if not isinstance(sim, SimOnLoop):
            raise PluginError(f"the fake '{sim.name}' cannot stand in a test of a mission: it has no `serve`")
        args = self._options(devices, sim)
        # The hardware's dice come from its name: one device more changes nothing for the others.
        machine = Machine(devices[0].name, fleet.timeline, random.Random(devices[0].name))
        fleet.network.plug_in(machine)
        process = Computer(machine, fleet.network, {}).start()
        process.on_fake = partial(self._serves, bus, devices, process)
        process.loop.set_exception_handler(self._raised)
        process.loop.enter(lambda: process.loop.create_task(self._serve(sim, args, devices)))

    def _options(self, devices: Sequence[DeviceBinding], sim: Sim) -> argparse.Namespace:
        parser = _Parser(prog=f"the fake '{sim.name}'", add_help=False)
        sim.add_arguments(parser)
        wrong = [_at(text, d.name) for d in devices for text in self._wrong.get(d.name, ())]
        options = [word for text in wrong for word in ("--fault", text)]
        return parser.parse_args([*sim.arguments(devices), *conditions(devices), *options])

    async def _serve(
        self, sim: SimOnLoop, args: argparse.Namespace, devices: Sequence[DeviceBinding]
    ) -> None:
        try:
            await sim.serve(args)
        except (LfieldError, ValueError) as error:
            self._problems.append(f"{devices[0].name}: {error}")

    def _raised(self, _: object, context: dict[str, Any]) -> None:
        """A bug of a fake: whoever runs the team raises it."""
        self.trouble.append(context.get("exception") or RuntimeError(context["message"]))

    def _serves(self, bus: Bus, devices: Sequence[DeviceBinding], process: Process, fake: Fake) -> None:
        self._served[bus] = process, fake
        numbers = {called: number for number, called in fake.devices.items()}
        for device in devices:
            number = numbers.get(device.name, next(iter(fake.devices), ""))
            self.devices[device.name] = FakeDevice(device.name, process, fake, number, self._mark)
        # What several fakes have between them, such as a box that their robots push, has a name of its own.
        for thing in fake.places.keys() - fake.devices.keys():
            self.devices[thing] = FakeDevice(thing, process, fake, thing, self._mark)

    def _wait(self, fleet: Fleet, buses: Mapping[Bus, Sequence[DeviceBinding]]) -> None:
        while self._served.keys() < buses.keys():
            if self._problems:
                raise MissionTestError("; ".join(self._problems))
            if fleet.now > READY:
                late = ", ".join(bus[0].name for name, bus in buses.items() if name not in self._served)
                raise MissionTestError(f"the fake of {late} was not ready within {READY:g} s")
            fleet.timeline.run(LOOK)


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are a test's, and end no process."""

    def error(self, message: str) -> None:  # type: ignore[override]
        raise MissionTestError(f"{self.prog}: {message}")

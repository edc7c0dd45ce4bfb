"""The fakes of a mission under test, on virtual time: each bus is on a cable beside its robot's computer."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence

from lfield.devices.fakes import conditions
from lfield.driver.binding import DeviceBinding
from lfield.driver.sims import sims_of
from lfield.errors import MissionTestError, PluginError
from lfield.loop import Fake
from lfield.mission.mission import Mission
from lfield.simulate.computers.computer import Process
from lfield.simulate.fleet import Fleet, at_endpoints, buses_of
from lfield.testing.cables import CabledFake, all_serve
from lfield.testing.mission import asked

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
        named = [_at(text, self._number) for text in asked.words(faults, f"{self.name}: set(...)")]

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
        self._cabled: dict[Bus, CabledFake] = {}
        #: By the names of their bindings.
        self.devices: dict[str, FakeDevice] = {}

    @property
    def trouble(self) -> list[Exception]:
        """What fakes have raised that they should not."""
        return [error for fake in self._cabled.values() for error in fake.trouble]

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
            options = [*sim.arguments(devices), *conditions(devices), *self._faults(devices)]
            self._cabled[bus] = CabledFake(devices[0].name, sim, options, fleet.timeline, fleet.network)
        served = all_serve(self._cabled, fleet.timeline)
        for bus, fake in served.items():
            self._name(buses[bus], self._cabled[bus].process, fake)
        return at_endpoints(mission, {d.name: served[bus].endpoint for bus in buses for d in buses[bus]})

    def _faults(self, devices: Sequence[DeviceBinding]) -> list[str]:
        wrong = [_at(text, d.name) for d in devices for text in self._wrong.get(d.name, ())]
        return [word for text in wrong for word in ("--fault", text)]

    def _name(self, devices: Sequence[DeviceBinding], process: Process, fake: Fake) -> None:
        numbers = {called: number for number, called in fake.devices.items()}
        for device in devices:
            number = numbers.get(device.name, next(iter(fake.devices), ""))
            self.devices[device.name] = FakeDevice(device.name, process, fake, number, self._mark)
        # What several fakes have between them, such as a box that their robots push, has a name of its own.
        for thing in fake.places.keys() - fake.devices.keys():
            self.devices[thing] = FakeDevice(thing, process, fake, thing, self._mark)

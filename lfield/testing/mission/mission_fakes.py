"""The simulated devices of a mission under test on virtual time: each bus is on a cable to its robot's
computer."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence

from lfield.devices.fake_processes import fault_options
from lfield.driver.binding import DeviceBinding
from lfield.driver.sims import sims_of
from lfield.errors import MissionTestError, PluginError
from lfield.event_loop import ServedFake
from lfield.mission.mission import Mission
from lfield.simulate.computers.simulated_computer import SimulatedProcess
from lfield.simulate.host_fleet import Fleet, at_endpoints, buses_of
from lfield.testing.cabled_fakes import CabledFake, wait_until_serving
from lfield.testing.mission import argument_checks

FakePosition = tuple[float, float, float]
#: Host, driver and endpoint.
BusKey = tuple[str, str, str]


class FakeDevice:
    """One device of a fake."""

    def __init__(
        self,
        name: str,
        process: SimulatedProcess,
        fake: ServedFake,
        number: str,
        mark: Callable[[str, str], None],
    ) -> None:
        self.name = name
        self._process, self._fake, self._number, self._mark = process, fake, number, mark

    def set(self, *faults: str) -> None:
        """Sets faults: `set("battery=0.2", "motor_failure=true")`.

        Raises MissionTestError for faults that this simulated device does not support.
        """
        errors: list[ValueError] = []
        named = [
            _at(text, self._number) for text in argument_checks.fault_texts(faults, f"{self.name}: set(...)")
        ]

        def apply() -> None:
            try:
                self._fake.faults.apply(named)
            except ValueError as error:
                errors.append(error)

        self._process.loop.enter(apply)
        if errors:
            raise MissionTestError(f"{self.name}: {errors[0]}")
        self._mark(f"{self.name}: {', '.join(faults)}", self.name)

    @property
    def facts(self) -> Mapping[str, str | int | bool]:
        """The true values of the device, independent of the wire: `facts["mode"]`. Empty if it provides
        none.
        """
        read = self._fake.facts.get(self._number)
        return read() if read else {}

    @property
    def place(self) -> FakePosition | None:
        """The position of the device: metres north, east and up of the place of power-on of simulated
        devices; None if unknown.
        """
        read = self._fake.places.get(self._number)
        return read() if read else None


def _at(text: str, number: str) -> str:
    name, equals, value = text.partition("=")
    return text if "@" in name else f"{name}@{number}{equals}{value}"


class MissionFakes:
    """All simulated devices of a mission. `faults` are initial faults, by device name.

    `mark` is called with a description and the device for later faults.
    """

    def __init__(
        self, faults: Mapping[str, Sequence[str]], mark: Callable[[str, str], None] = lambda text, name: None
    ) -> None:
        self._faults_by_device, self._mark = faults, mark
        self._cabled: dict[BusKey, CabledFake] = {}
        #: The devices by the names of their bindings.
        self.devices: dict[str, FakeDevice] = {}

    @property
    def failures(self) -> list[Exception]:
        """Unexpected exceptions of simulated devices."""
        return [error for fake in self._cabled.values() for error in fake.failures]

    def plug(self, fleet: Fleet, mission: Mission, _: random.Random) -> Mission:
        """Starts the devices; returns the mission with their endpoints. Raises PluginError and
        MissionTestError.
        """
        buses = buses_of(mission)
        names = {device.name for bus in buses.values() for device in bus}
        if unknown := sorted(self._faults_by_device.keys() - names):
            known = ", ".join(sorted(names)) or "none"
            raise MissionTestError(f"there is no simulated device '{unknown[0]}' here; there are: {known}")
        sims = sims_of({driver for _, driver, _ in buses})
        for bus, devices in buses.items():
            if (sim := sims.get(bus[1])) is None:
                raise PluginError(f"{devices[0].name}: there is no simulated device for driver '{bus[1]}'")
            options = [*sim.arguments(devices), *fault_options(devices), *self._faults(devices)]
            cabled = CabledFake(devices[0].name, sim, options, fleet.timeline, fleet.network)
            self._cabled[bus] = cabled
            fleet.stations.append(cabled.computer)
        served = wait_until_serving(self._cabled, fleet.timeline)
        for bus, fake in served.items():
            self._name(buses[bus], self._cabled[bus].process, fake)
        return at_endpoints(mission, {d.name: served[bus].endpoint for bus in buses for d in buses[bus]})

    def _faults(self, devices: Sequence[DeviceBinding]) -> list[str]:
        faults = [_at(text, d.name) for d in devices for text in self._faults_by_device.get(d.name, ())]
        return [argument for text in faults for argument in ("--fault", text)]

    def _name(self, devices: Sequence[DeviceBinding], process: SimulatedProcess, fake: ServedFake) -> None:
        numbers = {called: number for number, called in fake.devices.items()}
        for device in devices:
            number = numbers.get(device.name, next(iter(fake.devices), ""))
            self.devices[device.name] = FakeDevice(device.name, process, fake, number, self._mark)
        # Objects shared by several simulated devices, such as a box that their robots push, have names of
        # their own.
        for shared in [name for name in fake.places if name not in fake.devices]:
            self.devices[shared] = FakeDevice(shared, process, fake, shared, self._mark)

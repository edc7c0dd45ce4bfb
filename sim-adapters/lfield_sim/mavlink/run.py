"""A command line's vehicles, made and served until somebody says that it is enough."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

from lfield.errors import UsageError
from lfield_sim.autopilot.autopilot import FLAVOURS, Autopilot
from lfield_sim.autopilot.equipment import HARDWARE, Battery, Payload
from lfield_sim.faults import Faults
from lfield_sim.mavlink.geo import EARTH_RADIUS, PX4_RADIUS, Place, turned
from lfield_sim.mavlink.link.wire import KNOWN
from lfield_sim.mavlink.options import APART, Stand, VehicleOption
from lfield_sim.mavlink.protocol import MavlinkFake, MavlinkLink
from lfield_sim.mavlink.server import Server, open_door
from lfield_sim.mavlink.set_up import set_up, station
from lfield_sim.serving import serve_until_told
from lfield_sim.state_log import StateLog

#: The share of the capacity at which ArduPilot calls the battery low, when the capacity is set.
LOW = 0.2


@dataclass(frozen=True, slots=True)
class Setup:
    """The vehicles of a link, and what is set in them: charge, mAh, limits (SI).

    `origin` is where all are switched on, None for the usual field; `stands` are where single ones are of
    it, by system: the others stand side by side. `parameters` are by system, 0 for all; `fitted` is what
    hangs on them; `state` is what they do when their computer is gone ('': as they come out of the box,
    nothing). `board` is the number of the first one's board, one less than the next one's; 0 when they
    tell none.
    """

    vehicles: Sequence[VehicleOption]
    charge: float
    capacity: float | None
    limits: Mapping[str, float]
    parameters: Mapping[int, Mapping[str, float]]
    fitted: frozenset[str] = HARDWARE
    state: str = ""
    board: int = 0
    origin: Place | None = None
    stands: Mapping[int, Stand] = field(default_factory=dict)

    @property
    def devices(self) -> dict[str, str]:
        """System ids with the names of their bindings."""
        return {str(each.system): each.name for each in self.vehicles}

    def log(self, path: str, link: MavlinkLink) -> StateLog:
        """The vehicles' own log. Raises OutputFileError."""
        return StateLog(path, {str(each.system): each.autopilot.facts for each in link.vehicles})

    def faults(self, texts: Sequence[str]) -> Faults:
        """The faults of these vehicles, with what is wrong from the start. Raises ValueError."""
        faults = Faults(KNOWN, self.devices)
        faults.apply(texts)
        return faults

    def link(self, faults: Faults) -> MavlinkLink:
        """The vehicles, side by side. Raises UsageError for a parameter that none of them has."""
        made = [self._make(number, each, faults) for number, each in enumerate(self.vehicles)]
        for system, given in self.parameters.items():
            meant = [each.autopilot.parameters for each in made if system in (0, each.system)]
            for name in given:
                if not any(name in known for known in meant):
                    which = f"system {system}" if system else self.words
                    raise UsageError(f"there is no parameter '{name}' in {which}")
        return MavlinkLink(made)

    @property
    def words(self) -> str:
        """The vehicles for people: `copter system 1`."""
        return ", ".join(
            f"{each.kind} system {each.system}" + ("" if each.flavour == "ardupilot" else f" {each.flavour}")
            for each in self.vehicles
        )

    def _make(self, number: int, option: VehicleOption, faults: Faults) -> MavlinkFake:
        kind = FLAVOURS[option.flavour][option.kind]
        board = self.board + number if self.board else 0
        autopilot = Autopilot(kind, board=board, battery=Battery(self.charge), payload=Payload(self.fitted))
        stand = self.stands.get(option.system, Stand(east=number * APART))
        there = (self.origin or Place()).moved(stand.north, stand.east)
        radius = PX4_RADIUS if option.flavour == "px4" else EARTH_RADIUS
        place = replace(there, altitude=there.altitude - stand.down, radii=(radius, radius))
        fake = MavlinkFake(autopilot, system=option.system, place=place, faults=faults)
        for limit, (name, scale) in kind.speeds.items():
            # What speeds up both ways does so up and down, too.
            source = "acceleration" if limit == "vertical_acceleration" else limit
            if source in self.limits:
                autopilot.parameters[name] = self.limits[source] * scale
        if self.capacity is not None:
            autopilot.parameters[kind.flavour.capacity] = self.capacity
            for level in kind.flavour.battery[:1]:
                if level.of_capacity:
                    autopilot.parameters[level.threshold] = LOW * self.capacity
        known = autopilot.parameters
        wanted: Mapping[str, float] = {}
        if self.state:
            wanted = set_up(option.flavour, option.kind, self.state, station=station(option.system))
        for given in (wanted, self.parameters.get(0, {}), self.parameters.get(option.system, {})):
            known.update({name: value for name, value in given.items() if name in known})
        autopilot.apply_parameters()
        return fake

    def place(self, fake: MavlinkFake) -> tuple[float, float, float]:
        """Where a vehicle is, in metres north, east and up of where fakes are switched on.

        By the ellipsoid, where that is a place that somebody has given; else as its autopilot counts them.
        """
        stand, local = self.stands.get(fake.system, Stand()), fake.autopilot.vehicle.place
        north, east, down = turned(local, stand.heading)
        there = self.origin or replace(Place(), radii=fake.place.radii)
        up = fake.place.altitude - there.altitude - down
        return *there.local(*fake.place.at(north, east)), up


async def serve(
    link: MavlinkLink,
    where: tuple[str, str, int],
    setup: Setup,
    faults: Faults,
    log: StateLog,
    *,
    until_stdin_closes: bool,
) -> None:
    """Open the door, say so, and serve until told to end. Raises AddressError."""
    server = Server(link, log.look)
    door = await open_door(server, *where)
    ticking = asyncio.get_running_loop().create_task(server.tick())
    try:
        await serve_until_told(
            "mavlink", door.endpoint, setup.words, faults,
            devices=setup.devices, until_stdin_closes=until_stdin_closes,
            facts={str(each.system): each.autopilot.facts for each in link.vehicles},
            places={str(each.system): partial(setup.place, each) for each in link.vehicles},
        )  # fmt: skip
    finally:
        ticking.cancel()
        door.close()
        log.close()

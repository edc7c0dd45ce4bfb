"""Creates and serves the vehicles of a command line until it is stopped."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from functools import partial

from msgspec import Struct, field
from msgspec.structs import replace

from lfield.errors import UsageError
from lfield_sim.autopilot.autopilot import FLAVOURS, Autopilot
from lfield_sim.autopilot.equipment.payload import HARDWARE, Battery, Payload
from lfield_sim.fake_server import serve_until_stopped
from lfield_sim.faults import Faults
from lfield_sim.mavlink.geo import EARTH_RADIUS, PX4_RADIUS, GeoOrigin, turned
from lfield_sim.mavlink.link.radio_link import LINK_FAULTS
from lfield_sim.mavlink.link_server import LinkServer, open_endpoint
from lfield_sim.mavlink.mavlink_fake import MavlinkFake, MavlinkLink
from lfield_sim.mavlink.options import APART, Stand, VehicleOption
from lfield_sim.mavlink.setup_parameters import setup_parameters, station
from lfield_sim.state_log import StateLog

#: Share of the capacity at which ArduPilot reports a low battery, when the capacity is set.
LOW = 0.2


class LinkSetup(Struct, frozen=True):
    """The vehicles of a link, and their settings: charge, mAh, limits (SI).

    `origin` is the place of power-on of all, None for the default; `stands` are positions relative to it by
    system: the others are side by side. `parameters` are by system, 0 for all; `fitted` is their payload;
    `state` is their failsafe ('': factory settings, none). `board` is the board id of the first one,
    incremented for the next; 0 for none.
    """

    vehicles: Sequence[VehicleOption]
    charge: float
    capacity: float | None
    limits: Mapping[str, float]
    parameters: Mapping[int, Mapping[str, float]]
    fitted: frozenset[str] = HARDWARE
    state: str = ""
    board: int = 0
    origin: GeoOrigin | None = None
    stands: Mapping[int, Stand] = field(default_factory=dict)

    @property
    def devices(self) -> dict[str, str]:
        """System ids with the names of their bindings."""
        return {str(each.system): each.name for each in self.vehicles}

    def log(self, path: str, link: MavlinkLink) -> StateLog:
        """The vehicles' log. Raises OutputFileError."""
        return StateLog(path, {str(each.system): each.autopilot.facts for each in link.vehicles})

    def faults(self, texts: Sequence[str]) -> Faults:
        """The faults of these vehicles, with those set from the start. Raises ValueError."""
        faults = Faults(LINK_FAULTS, self.devices)
        faults.apply(texts)
        return faults

    def link(self, faults: Faults) -> MavlinkLink:
        """The vehicles, side by side. Raises UsageError for an unknown parameter."""
        vehicles = [self._make(number, each, faults) for number, each in enumerate(self.vehicles)]
        for system, values in self.parameters.items():
            tables = [each.autopilot.parameters for each in vehicles if system in (0, each.system)]
            for name in values:
                if not any(name in table for table in tables):
                    owner = f"system {system}" if system else self.summary
                    raise UsageError(f"there is no parameter '{name}' in {owner}")
        return MavlinkLink(vehicles)

    @property
    def summary(self) -> str:
        """Describes the vehicles: `copter system 1`."""
        return ", ".join(
            f"{each.kind} system {each.system}" + ("" if each.flavour == "ardupilot" else f" {each.flavour}")
            for each in self.vehicles
        )

    def _make(self, number: int, option: VehicleOption, faults: Faults) -> MavlinkFake:
        kind = FLAVOURS[option.flavour][option.kind]
        board = self.board + number if self.board else 0
        autopilot = Autopilot(kind, board=board, battery=Battery(self.charge), payload=Payload(self.fitted))
        stand = self.stands.get(option.system, Stand(east=number * APART))
        start = (self.origin or GeoOrigin()).moved(stand.north, stand.east)
        radius = PX4_RADIUS if option.flavour == "px4" else EARTH_RADIUS
        place = replace(start, altitude=start.altitude - stand.down, radii=(radius, radius))
        fake = MavlinkFake(autopilot, system=option.system, place=place, faults=faults)
        for limit, (name, scale) in kind.speeds.items():
            # A horizontal acceleration also sets the vertical one.
            source = "acceleration" if limit == "vertical_acceleration" else limit
            if source in self.limits:
                autopilot.parameters[name] = self.limits[source] * scale
        if self.capacity is not None:
            autopilot.parameters[kind.flavour.capacity] = self.capacity
            for level in kind.flavour.battery[:1]:
                if level.of_capacity:
                    autopilot.parameters[level.threshold] = LOW * self.capacity
        parameters = autopilot.parameters
        required: Mapping[str, float] = {}
        if self.state:
            required = setup_parameters(
                option.flavour, option.kind, self.state, station=station(option.system)
            )
        for values in (required, self.parameters.get(0, {}), self.parameters.get(option.system, {})):
            parameters.update({name: value for name, value in values.items() if name in parameters})
        autopilot.apply_parameters()
        return fake

    def place(self, fake: MavlinkFake) -> tuple[float, float, float]:
        """Position of a vehicle, in metres north, east and up of the place of power-on of simulated devices.

        On the ellipsoid for a given origin; else in its autopilot's metres.
        """
        stand, local = self.stands.get(fake.system, Stand()), fake.autopilot.vehicle.place
        north, east, down = turned(local, stand.heading)
        origin = self.origin or replace(GeoOrigin(), radii=fake.place.radii)
        height = fake.place.altitude - origin.altitude - down
        return *origin.local(*fake.place.at(north, east)), height


async def serve(
    link: MavlinkLink,
    address: tuple[str, str, int],
    setup: LinkSetup,
    faults: Faults,
    log: StateLog,
    *,
    until_stdin_closes: bool,
) -> None:
    """Opens the endpoint, reports it, and serves until it is stopped. Raises AddressError."""
    server = LinkServer(link, log.write_changes)
    endpoint = await open_endpoint(server, *address)
    server_task = asyncio.get_running_loop().create_task(server.tick())
    try:
        await serve_until_stopped(
            "mavlink", endpoint.endpoint, setup.summary, faults,
            devices=setup.devices, until_stdin_closes=until_stdin_closes,
            facts={str(each.system): each.autopilot.facts for each in link.vehicles},
            places={str(each.system): partial(setup.place, each) for each in link.vehicles},
        )  # fmt: skip
    finally:
        server_task.cancel()
        endpoint.close()
        log.close()

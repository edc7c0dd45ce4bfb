"""The bus: one or several links, a reader for each; passes every message to the vehicle that sent it."""

from __future__ import annotations

import asyncio
from functools import partial
from itertools import count
from typing import Any

from lfield.driver import DeviceBinding, DeviceError, Driver
from lfield_mavlink import log_messages
from lfield_mavlink.contact.components import PayloadSources, is_of_payload
from lfield_mavlink.link.dialect import (
    AUTOPILOT,
    Header,
    Reader,
    Writer,
    dialect,
    is_echo,
    request_message,
    station_heartbeat,
)
from lfield_mavlink.link.links import (
    RETRY_INTERVAL,
    Link,
    LinkEvents,
    LinkUses,
    OnData,
    make_link,
    split_endpoint,
)
from lfield_mavlink.link.packet_sources import Source, Sources
from lfield_mavlink.link.ports import (
    COMMANDS,
    LinkCounts,
    Neighbours,
    Port,
    Route,
    foreign_text,
    is_foreign,
)
from lfield_mavlink.link.signing import open_signing, sign_link
from lfield_mavlink.station_ids import check_stations, station_conflict_text, station_of
from lfield_mavlink.vehicle import LinkViews, MavlinkVehicle

#: Seconds between our heartbeats: several within the shortest failsafe (2 s), since some are lost.
HEARTBEAT = 0.25
#: Senders of foreign heartbeats that are logged, at most.
MOST_REPORTED = 16


class MavlinkDriver(Driver):
    """The vehicles on redundant links to the same place, such as a radio and a cable."""

    def _device(self, binding: DeviceBinding) -> MavlinkVehicle:
        system: int = binding.option("system")
        # Of two devices with one system id, neither is opened.
        sources = self._sources[system] = Sources(system, split_endpoint(self.endpoint))
        send = partial(self._send_to, system, station_of(binding))
        arguments = binding, self.manifests[binding.type], self.clock, self.reports
        links = LinkViews(self._counts, self._silence_reason, sources, partial(self._commander, system))
        return MavlinkVehicle(*arguments, send, links)

    def _set_up(self) -> None:
        self._sources: dict[int, Sources] = {}
        self._uses = LinkUses.parse(self.endpoint)
        self._payload = PayloadSources(self._uses.payload)

    async def _open(self) -> None:
        self._is_quiet = False
        self._ports: list[Port] = []
        self._neighbours = Neighbours()
        self._addresses: dict[int, str] = {}
        self._reported: set[tuple[int, Source]] = set()
        self._received_bytes = 0
        self._vehicles: dict[int, MavlinkVehicle] = {}
        for device in self.devices.values():
            assert isinstance(device, MavlinkVehicle)
            if device.system in self._vehicles:
                raise device.error(f"two devices are system {device.system} on {self.endpoint}")
            self._vehicles[device.system] = device
        check_stations(self.bindings)
        self._stations = {vehicle.station: vehicle for vehicle in self._vehicles.values()}
        self._signing = open_signing(self.bindings, self.clock)
        endpoints = split_endpoint(self.endpoint)
        self._routes = {system: Route(self._uses.vehicles) for system in self._vehicles}
        self._ports += [self._make_port(number, endpoint) for number, endpoint in enumerate(endpoints)]
        await self._open_links()
        self.spawn(self._send_heartbeats())
        if self._signing is not None:
            self.spawn(self._signing.keep_ahead(next(iter(self._vehicles.values())).note))
        for vehicle in self._vehicles.values():
            for task in vehicle.background_tasks():
                self.spawn(task)

    async def _close(self) -> None:
        for vehicle in self._vehicles.values():
            vehicle.stop_setpoints()
        for port in self._ports:
            port.link.close()

    def _quiet(self) -> None:
        """Stops heartbeats and requests: the autopilots' own failsafes must be able to start."""
        self._is_quiet = True
        for vehicle in self._vehicles.values():
            vehicle.set_quiet(True)
            vehicle.stop_setpoints()

    def _resume(self) -> None:
        self._is_quiet = False
        for vehicle in self._vehicles.values():
            vehicle.set_quiet(False)

    # -- links ----------------------------------------------------------------------------------------

    def _make_link(self, endpoint: str, on_data: OnData) -> Link:
        number = split_endpoint(self.endpoint).index(endpoint)
        return make_link(
            endpoint, on_data, LinkEvents(self._note, self._reopened, partial(self._from, number))
        )

    def _from(self, link: int, address: str) -> None:
        """Sets the address of the next bytes of a link."""
        self._addresses[link] = address

    def _note(self, text: str) -> None:
        for vehicle in self._vehicles.values():
            vehicle.note(text)

    def _reopened(self) -> None:
        for vehicle in self._vehicles.values():
            vehicle.reconnected()

    def _make_port(self, number: int, endpoint: str) -> Port:
        signing = sign_link(self._signing, self.bindings, number, endpoint)
        reader, writer = Reader(signing, self.wire_log.log_mavlink), Writer(signing)
        link = self._make_link(endpoint, partial(self._received, number, reader))
        return Port(link, reader, writer, signing, self.wire_log)

    def _counts(self) -> LinkCounts:
        return LinkCounts.total(self._ports, self._signing)

    async def _open_links(self) -> None:
        """Opens all links. A link that fails is retried as long as another one works."""
        opened = await asyncio.gather(*(port.link.open() for port in self._ports), return_exceptions=True)
        problems = [error for error in opened if isinstance(error, BaseException)]
        if len(problems) == len(self._ports) or any(not isinstance(e, DeviceError) for e in problems):
            raise problems[0]
        for name, port, error in zip(split_endpoint(self.endpoint), self._ports, opened, strict=True):
            if isinstance(error, DeviceError):
                self._note(log_messages.LINK_UNOPENED.line(reason=error.reason))
                self.spawn(self._open_later(name, port.link, error.reason))

    async def _open_later(self, name: str, link: Link, reason: str) -> None:
        """Opens a link as soon as possible; logs each reason for a failure once."""
        reported = {reason}
        for attempt in count(2):
            await asyncio.sleep(RETRY_INTERVAL)
            try:
                await link.open()
            except DeviceError as error:
                if error.reason not in reported:
                    reported.add(error.reason)
                    self._note(log_messages.LINK_STILL_UNOPENED.line(reason=error.reason, attempt=attempt))
                continue
            self._note(log_messages.LINK_OPENED.line(link=name, attempts=attempt))
            return

    # -- messages -------------------------------------------------------------------------------------

    def _silence_reason(self) -> str:
        """The reason why no message of a vehicle may arrive: other vehicles send, or noise, or no sender."""
        if neighbours := str(self._neighbours):
            return f"received: {neighbours}; is 'system' in its binding right?"
        if self._received_bytes:
            count = self._received_bytes
            return f"the {count} received bytes contain no heartbeat; is it the right port and baud rate?"
        return "; ".join(self._ports[number].link.silence_reason() for number in self._uses.vehicles)

    def _commander(self, system: int) -> str:
        """Another station that has just commanded a vehicle, as far as received on the links."""
        return self._neighbours.commander(system, self.clock.monotonic())

    def _received(self, link: int, reader: Reader, data: bytes) -> None:
        self._received_bytes += len(data)
        source = Source(link, self._addresses.get(link, ""))
        for message in reader.feed(data, partial(self._is_spare, source)):
            system = message.get_srcSystem()
            vehicle = self._vehicles.get(system)
            if link not in self._uses.vehicles:
                self._on_payload(source, message)
            elif message.get_msgId() in COMMANDS:
                # A router may echo what we have sent.
                if system not in self._stations:
                    self._neighbours.on_command(message, self.clock.monotonic())
            # Cameras and gimbals send heartbeats too; only the autopilot's contain the vehicle's state.
            elif vehicle is None or message.get_srcComponent() != AUTOPILOT:
                self._on_neighbour(message)
                self._on_payload(source, message)
            elif is_foreign(message, vehicle.state.autopilot):
                self._neighbours.on_message(message)
                self._report_foreign(vehicle, source, message)
            else:
                self._on_vehicle(vehicle, source, message)

    def _on_vehicle(self, vehicle: MavlinkVehicle, source: Source, message: Any) -> None:
        """Handles a message with the ids of a vehicle's autopilot."""
        system, now = vehicle.system, self.clock.monotonic()
        if not self._sources[system].on_packet(source, message, now):
            vehicle.on_other_source()
        elif self._routes[system].on_packet(source.link, message.get_msgbuf(), now):
            vehicle.on_message(message)

    def _on_payload(self, source: Source, message: Any) -> None:
        """Handles a message of a camera or gimbal; of another vehicle with this system id, it is ignored."""
        system, component, kind = message.get_srcSystem(), message.get_srcComponent(), message.get_msgId()
        if system not in self._vehicles or not is_of_payload(component, kind):
            return
        ids, now = (system, component), self.clock.monotonic()
        if self._payload.accepts(source, ids, kind, now) or self._sources[system].accepts(source):
            self._vehicles[system].on_component(message)

    def _report_foreign(self, vehicle: MavlinkVehicle, source: Source, message: Any) -> None:
        """Ignores a heartbeat of a component that is no autopilot but uses its ids: logged once per
        source.
        """
        if (vehicle.system, source) in self._reported or len(self._reported) >= MOST_REPORTED:
            return
        self._reported.add((vehicle.system, source))
        endpoint = split_endpoint(self.endpoint)[source.link]
        place = f"{endpoint} from {source.address}" if source.address else endpoint
        vehicle.note(
            log_messages.FOREIGN_COMPONENT.line(
                sender=foreign_text(message), system=vehicle.system, component=AUTOPILOT, place=place
            )
        )

    def _on_neighbour(self, message: Any) -> None:
        """Handles a message of another system, whose id must differ from our stations'."""
        self._neighbours.on_message(message)
        vehicle = self._stations.get(message.get_srcSystem())
        if vehicle is None or message.get_msgId() != dialect.MAVLINK_MSG_ID_HEARTBEAT:
            return
        if not is_echo(message, vehicle.system) and not vehicle.station_conflict:
            vehicle.report_station_conflict(station_conflict_text(message))

    def _is_spare(self, source: Source, header: Header) -> bool:
        """Whether a packet need not be decoded: from an unknown system, or telemetry faster than needed.

        Telemetry is faster when a ground station on the same link requests it; decoding is most of the load
        then.
        """
        vehicle = self._vehicles.get(header.system)
        if vehicle is None or header.component != AUTOPILOT:
            if vehicle is not None and is_of_payload(header.component, header.kind):
                return False
            return header.kind != int(dialect.MAVLINK_MSG_ID_HEARTBEAT) and header.kind not in COMMANDS
        sources = self._sources[header.system]
        if len(self._uses.vehicles) > 1 or not sources.accepts(source):
            return False
        is_spare = vehicle.is_spare(header.kind, header.sequence)
        if is_spare:
            sources.touch(source, self.clock.monotonic())
        return is_spare

    def _send_to(self, system: int, station: int, message: Any) -> None:
        payload = self._payload.source((system, getattr(message, "target_component", 0)))
        if payload is not None:
            self._ports[payload.link].send(message, station, payload.address)
            return
        for number in self._routes[system].links(self.clock.monotonic()):
            self._ports[number].send(message, station, self._sources[system].address(number))

    async def _send_heartbeats(self) -> None:
        """Sends a heartbeat as the ground station of each vehicle on every link, for their failsafes."""
        beats = [(vehicle, station_heartbeat(vehicle.system)) for vehicle in self._vehicles.values()]
        while True:
            for vehicle, message in () if self._is_quiet else beats:
                for port in self._heartbeat_ports(vehicle):
                    port.send(message, vehicle.station)
            if not self._is_quiet:
                self._request_boards()
            await asyncio.sleep(HEARTBEAT)

    def _heartbeat_ports(self, vehicle: MavlinkVehicle) -> list[Port]:
        """The links for heartbeats of a vehicle's station, except those that lead to payload only."""
        on_all_links = vehicle.may_send_heartbeat
        return [
            port
            for number, port in enumerate(self._ports)
            if on_all_links or number not in self._uses.vehicles
        ]

    def _request_boards(self) -> None:
        """Requests the unique id over other links with the same system id: it may be another vehicle."""
        now = self.clock.monotonic()
        for system, sources in self._sources.items():
            for source in sources.due(now):
                request = request_message(system, dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
                station = self._vehicles[system].station
                self._ports[source.link].send(request, station, source.address)

"""Simulated vehicles at packet level: packets in, packets out, time given. No sockets and no clock.

`receive` answers a packet to its sender; `advance` advances time and returns packets for every peer:
heartbeats, streams, messages of services, status texts. ArduPilot streams only heartbeats without a request,
PX4 streams at once.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from random import Random
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.flavours import MavResult
from lfield_sim.autopilot.plans import MissionItem
from lfield_sim.faults import Faults
from lfield_sim.mavlink.command_handlers import answer, second_answer
from lfield_sim.mavlink.equipment.components import components_of
from lfield_sim.mavlink.equipment.equipment_commands import EquipmentCommands
from lfield_sim.mavlink.equipment.gimbal_service import GimbalService
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.link.codec import PacketReaders, PacketWriter
from lfield_sim.mavlink.link.radio_link import LINK_FAULTS, RadioLink, make_faults
from lfield_sim.mavlink.link.signing import MessageSigning
from lfield_sim.mavlink.mav_command import CommandAnswer, DelayedResult, MavCommand
from lfield_sim.mavlink.message_sender import MessageSender
from lfield_sim.mavlink.services.file_service import FileService
from lfield_sim.mavlink.services.information_service import InformationService
from lfield_sim.mavlink.services.motor_test import MotorTest
from lfield_sim.mavlink.services.parameters import ParameterService
from lfield_sim.mavlink.services.plan_service import PlanService
from lfield_sim.mavlink.services.preflight import PreflightService
from lfield_sim.mavlink.services.service import VehicleService
from lfield_sim.mavlink.setpoints import attitude_target, global_target, local_target
from lfield_sim.mavlink.telemetry.message_table import DATA_STREAMS

#: The autopilot's component.
COMPONENT = 1
#: Length of a model step, in seconds.
STEP = 0.02
#: The services, created for each vehicle.
SERVICES: tuple[type[VehicleService], ...] = (
    ParameterService, PlanService, FileService, EquipmentCommands, GimbalService, InformationService,
    MotorTest, PreflightService,
)  # fmt: skip
#: Faults that are a state of the vehicle: the attribute of the autopilot.
STATES = {
    "refuse_arming": "refuse_arming",
    "gps_loss": "gps_lost",
    "gps_glitch": "gps_glitch",
    "compass_failure": "compass_failed",
    "motor_failure": "motor_failed",
    "motor_power": "motor_power",
    "sticks": "sticks",
    "warm_up": "warm_up",
}
#: The position of the vehicle: initially the origin of its frame, later it is moved.
OFFSETS = ("north", "east")
#: Faults that are a state of the air: the attribute of its wind.
AIR = {"wind": "speed", "wind_from": "source", "gusts": "gusts"}


class MavlinkFake:
    """One autopilot on the wire. `faults` may be shared with other vehicles; its own are those of
    `system`.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        *,
        system: int = 1,
        place: GeoOrigin | None = None,
        faults: Faults | None = None,
    ) -> None:
        self.autopilot, self.system = autopilot, system
        self.faults = faults or make_faults(systems=(system,))
        offsets = {name: self.faults.get(name, system) for name in OFFSETS}
        self.place = (place or GeoOrigin()).moved(**offsets)
        autopilot.altitude = self.place.altitude
        autopilot.vehicle.wind.rng = Random(system)
        autopilot.set_home(autopilot.vehicle.place)
        self.services = [kind(autopilot, self.place) for kind in SERVICES]
        self.sender = MessageSender(autopilot, self.place, self.services)
        self.gate = MessageSigning(system, lambda: autopilot.now)
        self.wire = RadioLink(self.faults, system)
        self.components = components_of(autopilot, self.place)
        self._writers = {number: PacketWriter(system, number) for number in (COMPONENT, *self.components)}
        self._readers = PacketReaders()
        self._pending_time = 0.0
        self._known_faults = {fault.name: fault.default for fault in LINK_FAULTS} | offsets
        self._apply_faults()
        self.faults.watch(self._apply_faults)
        autopilot.perform = self._perform

    @property
    def silent(self) -> bool:
        """Whether the vehicle neither receives nor sends now."""
        return self.wire.silent or self.autopilot.booting

    def receive(self, peer: Hashable, data: bytes, *, local: bool = False) -> list[bytes]:
        """Handles bytes from a peer; returns the answers. `local` is a peer on a serial line."""
        messages = self._readers.feed(peer, data)
        return [packet for message in messages for packet in self.handle(message, local=local)]

    def handle(self, message: Any, *, local: bool = False) -> list[bytes]:
        """Handles a message from a peer; returns the answers."""
        if self.silent or not self._is_addressed(message) or not self.wire.receives():
            return []
        if not self.gate.admits(message, local=local):
            return []
        self.sender.on_peer()
        kind, addressee = message.get_msgId(), getattr(message, "target_component", 0)
        if addressee in self.components:
            replies = self._on_command(message, addressee) if kind in COMMANDS else []
            return self._transmit(replies, addressee)
        handler = HANDLERS.get(kind)
        replies = handler(self, message) if handler else []
        for service in self.services:
            if kind in service.handles:
                replies = [*replies, *service.handles[kind](message)]
        return self._transmit(replies)

    def advance(self, seconds: float) -> list[bytes]:
        """Advances time; returns the packets for every peer."""
        self._pending_time += seconds
        messages: list[Any] = []
        while self._pending_time >= STEP:
            self._pending_time -= STEP
            messages += self._step()
        if self.autopilot.booting:
            return []
        messages += self.sender.due()
        now = self.autopilot.now
        packets = [*self.wire.arrived(now), *self._transmit(messages)]
        for number, component in self.components.items():
            packets += self._transmit(component.advance(now), number)
        return packets

    def _step(self) -> list[Any]:
        self.autopilot.step(STEP)
        if self.autopilot.booting:
            return []
        return [m for service in self.services for m in service.advance(self.autopilot.now)]

    # -- messages -------------------------------------------------------------------------------------

    def _is_addressed(self, message: Any) -> bool:
        if getattr(message, "target_system", 0) not in (0, self.system):
            return False
        component = getattr(message, "target_component", 0)
        is_known = component in (0, COMPONENT) or component in self.components
        return is_known or self.autopilot.flavour.serves_components

    def _on_heartbeat(self, message: Any) -> list[Any]:
        station = message.type == dialect.MAV_TYPE_GCS
        self.autopilot.failsafes.heartbeat(message.get_srcSystem(), station=station)
        return []

    def _on_command(self, message: Any, addressee: int = COMPONENT) -> list[Any]:
        command = _command(message)

        def ack(result: MavResult) -> Any:
            return dialect.MAVLink_command_ack_message(command.number, int(result), 0, 0, *command.source)

        if addressee != COMPONENT:
            outcome, replies = self.components[addressee].answer(command)
            return [ack(outcome), *replies]
        if self.sender.is_late(command.number):
            return [ack(MavResult.IN_PROGRESS)]
        result, replies = self._answer(command)
        if result is None:
            return replies
        if isinstance(result, DelayedResult):
            self.sender.acknowledge_later(command.number, ack(result.result), result.seconds)
            return [ack(MavResult.IN_PROGRESS), *replies] if result.progress else replies
        slow: float = self.faults.get("slow_acks", self.system)
        if slow > 0.0 and result is not MavResult.UNSUPPORTED:
            self.sender.acknowledge_later(command.number, ack(result), slow)
            return [ack(MavResult.IN_PROGRESS), *replies]
        second = second_answer(self.sender, command)
        return [ack(result), *replies] if second is None else [ack(result), ack(second), *replies]

    def _answer(self, command: MavCommand) -> CommandAnswer:
        for service in self.services:
            if command.number in service.commands:
                return service.commands[command.number](command)
        return answer(self.sender, command)

    def _perform(self, item: MissionItem) -> None:
        """Executes a mission item that is not flown."""
        self._answer(MavCommand(item.command, item.values))

    def _on_set_mode(self, message: Any) -> list[Any]:
        self.autopilot.set_mode(message.custom_mode)
        return []

    def _on_local_target(self, message: Any) -> list[Any]:
        return self._guide(local_target(self.autopilot, message))

    def _on_global_target(self, message: Any) -> list[Any]:
        return self._guide(global_target(self.autopilot, self.place, message))

    def _on_attitude_target(self, message: Any) -> list[Any]:
        return self._guide(attitude_target(message))

    def _guide(self, setpoint: Any) -> list[Any]:
        if setpoint is not None:
            self.autopilot.guide(setpoint)
        return []

    def _on_request_data_stream(self, message: Any) -> list[Any]:
        all_kinds = [kind for kinds in DATA_STREAMS.values() for kind in kinds]
        messages = DATA_STREAMS.get(message.req_stream_id, ()) if message.req_stream_id else all_kinds
        if self.autopilot.flavour.heeds_groups:
            self.sender.stream_group(messages, float(message.req_message_rate) if message.start_stop else 0.0)
        return []

    def _on_timesync(self, message: Any) -> list[Any]:
        if message.tc1 != 0:
            return []
        return [dialect.MAVLink_timesync_message(int(self.autopilot.uptime * 1e9), message.ts1)]

    def _on_ping(self, message: Any) -> list[Any]:
        if message.target_system:
            return []
        source = message.get_srcSystem(), message.get_srcComponent()
        return [dialect.MAVLink_ping_message(message.time_usec, message.seq, *source)]

    def _apply_faults(self) -> None:
        """Applies changed faults that are a state of the vehicle."""
        previous = self._known_faults
        changed = {name: self.faults.get(name, self.system) for name in previous}
        for name in STATES:
            if changed[name] != previous[name]:
                setattr(self.autopilot, STATES[name], changed[name])
        for name in AIR:
            setattr(self.autopilot.vehicle.wind, AIR[name], changed[name])
        self.autopilot.vehicle.ground = changed["ground"]
        camera = self.autopilot.payload.camera
        camera.card, camera.broken = changed["card"], changed["camera_failure"]
        self.autopilot.payload.gimbal.is_secret = changed["gimbal_secret"]
        north, east = (changed[name] - previous[name] for name in OFFSETS)
        place = self.autopilot.vehicle.place
        self.autopilot.vehicle.place = (place[0] + north, place[1] + east, place[2])
        if changed["battery"] != previous["battery"]:
            self.autopilot.battery.charge = changed["battery"]
        self._known_faults = changed

    def _transmit(self, messages: list[Any], component: int = COMPONENT) -> list[bytes]:
        """Sends messages of a component; returns the packets that arrive at once."""
        packets = [self._pack(message, component) for message in messages]
        return self.wire.send(packets, self.autopilot.now)

    def _pack(self, message: Any, component: int = COMPONENT) -> bytes:
        writer = self._writers[component]
        self.gate.seal(writer.packer)
        return writer.pack(message)


def _command(message: Any) -> MavCommand:
    """The command in a COMMAND_LONG or COMMAND_INT."""
    source = message.get_srcSystem(), message.get_srcComponent()
    if message.get_msgId() == dialect.MAVLINK_MSG_ID_COMMAND_LONG:
        values = tuple(getattr(message, f"param{i}") for i in range(1, 8))
        return MavCommand(message.command, values, source=source)
    values = (*(getattr(message, f"param{i}") for i in range(1, 5)), message.x, message.y, message.z)
    return MavCommand(message.command, values, message.frame, source)


#: Messages with commands.
COMMANDS = (dialect.MAVLINK_MSG_ID_COMMAND_INT, dialect.MAVLINK_MSG_ID_COMMAND_LONG)

#: Handlers of messages, in addition to the services.
HANDLERS = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: MavlinkFake._on_heartbeat,
    dialect.MAVLINK_MSG_ID_PING: MavlinkFake._on_ping,
    dialect.MAVLINK_MSG_ID_SET_MODE: MavlinkFake._on_set_mode,
    dialect.MAVLINK_MSG_ID_REQUEST_DATA_STREAM: MavlinkFake._on_request_data_stream,
    dialect.MAVLINK_MSG_ID_COMMAND_INT: MavlinkFake._on_command,
    dialect.MAVLINK_MSG_ID_COMMAND_LONG: MavlinkFake._on_command,
    dialect.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET: MavlinkFake._on_attitude_target,
    dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: MavlinkFake._on_local_target,
    dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: MavlinkFake._on_global_target,
    dialect.MAVLINK_MSG_ID_TIMESYNC: MavlinkFake._on_timesync,
}


class MavlinkLink:
    """The vehicles of one link, by system id."""

    def __init__(self, vehicles: Sequence[MavlinkFake]) -> None:
        self.vehicles = vehicles
        self._readers = PacketReaders()

    def receive(self, peer: Hashable, data: bytes, *, local: bool = False) -> list[bytes]:
        """Handles bytes from a peer; returns the answers. `local` is a peer on a serial line."""
        return [
            packet
            for message in self._readers.feed(peer, data)
            for vehicle in self.vehicles
            for packet in vehicle.handle(message, local=local)
        ]

    def advance(self, seconds: float) -> list[bytes]:
        """Advances time; returns the packets for every peer."""
        return [packet for vehicle in self.vehicles for packet in vehicle.advance(seconds)]

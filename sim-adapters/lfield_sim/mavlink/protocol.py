"""The fake at packet level: packets in, packets out, time given. Knows no sockets and no clock of its own.

`receive` answers a packet to the peer that sent it; `advance` moves time and returns what every peer
gets: heartbeats, the streams that were asked for, and status texts. Like ArduPilot, it streams nothing
but heartbeats until somebody asks.
"""

from __future__ import annotations

import math
import random
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from lfield_sim.autopilot import Autopilot
from lfield_sim.mavlink.codec import Reader, Writer
from lfield_sim.mavlink.commands import Answer, Command, answer
from lfield_sim.mavlink.place import Place
from lfield_sim.mavlink.services import SERVICES
from lfield_sim.mavlink.telemetry import DATA_STREAMS, HEARTBEAT, MESSAGES

#: The autopilot's component. Like ArduPilot, it takes commands for any component.
COMPONENT = 1
#: Length of a model step, in seconds.
STEP = 0.02
#: At most so many peers are remembered; the one that was silent longest is forgotten.
MAX_PEERS = 16
#: Nothing is streamed faster than this, in Hz.
MAX_RATE = 100.0
#: Characters of a STATUSTEXT; longer texts go out in chunks.
TEXT_CHUNK = 50

# type_mask bits of SET_POSITION_TARGET_LOCAL_NED: set means "ignore".
IGNORE_POSITION, IGNORE_VELOCITY, IGNORE_YAW = 0x7, 0x38, 0x400


@dataclass(frozen=True, slots=True)
class Faults:
    """What goes wrong on the wire: a share of packets lost both ways, silence from a time on (s)."""

    loss: float = 0.0
    silent_after: float = math.inf
    seed: int = 1


@dataclass(slots=True)
class _Stream:
    interval: float
    due: float


class MavlinkFake:
    """One autopilot on the wire."""

    def __init__(
        self,
        autopilot: Autopilot,
        *,
        system: int = 1,
        place: Place | None = None,
        faults: Faults | None = None,
    ) -> None:
        self.autopilot, self.system = autopilot, system
        self.place, self.faults = place or Place(), faults or Faults()
        self._random = random.Random(self.faults.seed)
        self.services = [kind(autopilot, self.place) for kind in SERVICES]
        self._writer = Writer(system, COMPONENT)
        self._readers: OrderedDict[Hashable, Reader] = OrderedDict()
        self._streams = {HEARTBEAT: _Stream(1.0, 0.0)}
        self._rest = 0.0
        self._text_id = 0

    @property
    def silent(self) -> bool:
        """Whether the fault `silent_after` has begun."""
        return self.autopilot.uptime >= self.faults.silent_after

    def receive(self, peer: Hashable, data: bytes) -> list[bytes]:
        """Bytes from a peer; the packets that answer them."""
        reader = self._readers.setdefault(peer, Reader())
        self._readers.move_to_end(peer)
        if len(self._readers) > MAX_PEERS:
            self._readers.popitem(last=False)
        answers = [
            packet
            for message in reader.feed(data)
            if not self.silent and not self._lost()
            for packet in self._handle(message)
        ]
        return self._sent(answers)

    def advance(self, seconds: float) -> list[bytes]:
        """Let time pass; the packets for every peer."""
        packets: list[bytes] = []
        self._rest += seconds
        while self._rest >= STEP:
            self.autopilot.step(STEP)
            self._rest -= STEP
            packets += [
                self._pack(message)
                for service in self.services
                for message in service.advance(self.autopilot.uptime)
            ]
        packets += [self._pack(MESSAGES[kind](self.autopilot, self.place)) for kind in self._due()]
        for severity, text in self.autopilot.take_texts():
            packets += self._text(severity, text)
        return self._sent(packets)

    # -- what the command table uses ------------------------------------------------------------------

    def stream(self, kind: int, rate: float) -> None:
        """Stream a message at a rate in Hz; 0 stops it, but for the heartbeat, which goes on at 1 Hz."""
        if kind == HEARTBEAT:
            rate = max(rate, 1.0)
        if rate <= 0.0:
            self._streams.pop(kind, None)
        else:
            self._streams[kind] = _Stream(1.0 / min(rate, MAX_RATE), self.autopilot.uptime)

    def interval(self, kind: int) -> float:
        """Seconds between two messages of a stream; 0 when it is not streamed."""
        return self._streams[kind].interval if kind in self._streams else 0.0

    # -- packets --------------------------------------------------------------------------------------

    def _handle(self, message: Any) -> list[bytes]:
        target = getattr(message, "target_system", 0)
        if target not in (0, self.system):
            return []
        kind = message.get_msgId()
        own = _HANDLERS.get(kind)
        replies = own(self, message) if own else []
        for service in self.services:
            if kind in service.handles:
                replies += service.handles[kind](message)
        return [self._pack(reply) for reply in replies]

    def _on_heartbeat(self, message: Any) -> list[Any]:
        if message.get_srcSystem() == int(self.autopilot.parameters["MAV_GCS_SYSID"]):
            self.autopilot.gcs_heartbeat()
        return []

    def _on_command_long(self, message: Any) -> list[Any]:
        values = tuple(getattr(message, f"param{i}") for i in range(1, 8))
        return self._on_command(message, values)

    def _on_command_int(self, message: Any) -> list[Any]:
        values = (*(getattr(message, f"param{i}") for i in range(1, 5)), message.x, message.y, message.z)
        return self._on_command(message, values)

    def _on_command(self, message: Any, values: tuple[float, ...]) -> list[Any]:
        command = Command(message.command, values)
        result, replies = self._answer(command)
        source = message.get_srcSystem(), message.get_srcComponent()
        return [dialect.MAVLink_command_ack_message(command.number, int(result), 0, 0, *source), *replies]

    def _answer(self, command: Command) -> Answer:
        for service in self.services:
            if command.number in service.commands:
                return service.commands[command.number](command)
        return answer(self, command)

    def _on_set_mode(self, message: Any) -> list[Any]:
        self.autopilot.set_mode(message.custom_mode)
        return []

    def _on_position_target(self, message: Any) -> list[Any]:
        mask = message.type_mask
        offset = message.coordinate_frame in (
            dialect.MAV_FRAME_LOCAL_OFFSET_NED,
            dialect.MAV_FRAME_BODY_NED,
            dialect.MAV_FRAME_BODY_OFFSET_NED,
        )
        if offset:
            return []
        place = (message.x, message.y, message.z)
        velocity = (message.vx, message.vy, message.vz)
        if not mask & IGNORE_YAW and math.isfinite(message.yaw):
            self.autopilot.set_yaw(message.yaw)
        if not mask & IGNORE_POSITION and all(map(math.isfinite, place)):
            self.autopilot.guide_to(place)
        elif not mask & IGNORE_VELOCITY and all(map(math.isfinite, velocity)):
            self.autopilot.guide_along(velocity)
        return []

    def _on_request_data_stream(self, message: Any) -> list[Any]:
        wanted = (
            DATA_STREAMS.values()
            if message.req_stream_id == 0
            else [DATA_STREAMS.get(message.req_stream_id, ())]
        )
        rate = float(message.req_message_rate) if message.start_stop else 0.0
        for kinds in wanted:
            for kind in kinds:
                self.stream(kind, rate)
        return []

    def _on_timesync(self, message: Any) -> list[Any]:
        if message.tc1 != 0:
            return []
        return [dialect.MAVLink_timesync_message(int(self.autopilot.uptime * 1e9), message.ts1)]

    def _due(self) -> list[int]:
        now = self.autopilot.uptime
        due = [kind for kind, stream in self._streams.items() if now >= stream.due]
        for kind in due:
            stream = self._streams[kind]
            # After a pause there is one message, not the whole backlog.
            stream.due = max(stream.due + stream.interval, now)
        return due

    def _text(self, severity: int, text: str) -> list[bytes]:
        data = text.encode("ascii", "replace")
        if len(data) <= TEXT_CHUNK:
            return [self._pack(dialect.MAVLink_statustext_message(int(severity), data))]
        self._text_id = self._text_id % 0xFFFF + 1
        # A last chunk that is full would not end the text: an empty one must follow.
        chunks = [data[i : i + TEXT_CHUNK] for i in range(0, len(data) + 1, TEXT_CHUNK)]
        return [
            self._pack(dialect.MAVLink_statustext_message(int(severity), chunk, self._text_id, number))
            for number, chunk in enumerate(chunks)
        ]

    def _pack(self, message: Any) -> bytes:
        return self._writer.pack(message)

    def _lost(self) -> bool:
        return self.faults.loss > 0.0 and self._random.random() < self.faults.loss

    def _sent(self, packets: list[bytes]) -> list[bytes]:
        return [] if self.silent else [packet for packet in packets if not self._lost()]


_HANDLERS = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: MavlinkFake._on_heartbeat,
    dialect.MAVLINK_MSG_ID_SET_MODE: MavlinkFake._on_set_mode,
    dialect.MAVLINK_MSG_ID_REQUEST_DATA_STREAM: MavlinkFake._on_request_data_stream,
    dialect.MAVLINK_MSG_ID_COMMAND_INT: MavlinkFake._on_command_int,
    dialect.MAVLINK_MSG_ID_COMMAND_LONG: MavlinkFake._on_command_long,
    dialect.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: MavlinkFake._on_position_target,
    dialect.MAVLINK_MSG_ID_TIMESYNC: MavlinkFake._on_timesync,
}

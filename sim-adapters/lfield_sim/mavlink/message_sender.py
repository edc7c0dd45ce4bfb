"""Outgoing messages of a vehicle: requested or streamed, delayed answers, texts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from msgspec import Struct
from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.body.goals import Vector
from lfield_sim.autopilot.flavours import MavResult, Role
from lfield_sim.autopilot.monitoring.arming_readiness import has_home, has_origin, has_position
from lfield_sim.autopilot.stacks.text_severity import severity_of
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.services.service import VehicleService
from lfield_sim.mavlink.telemetry.message_table import MESSAGES, POSITIONS
from lfield_sim.mavlink.telemetry.target_messages import goal_of, sends_setpoint

#: Maximum stream rate in Hz.
MAX_RATE = 100.0
#: The message that is always sent, at least at 1 Hz.
HEARTBEAT = 0
#: Messages with home, and with the origin of the local frame.
HOME_POSITION, GPS_GLOBAL_ORIGIN = 242, 49
#: PX4's message at a change of mode, otherwise after at least so many seconds.
CURRENT_MODE, MODE_PAUSE = 436, 0.5
#: Characters of a STATUSTEXT; longer texts are sent in chunks, up to a maximum.
CHUNK, CHUNKS = 50, 256


class MessageSender:
    """The messages that one vehicle can send, and those that are due."""

    def __init__(self, autopilot: Autopilot, place: GeoOrigin, services: Sequence[VehicleService]) -> None:
        self.autopilot, self.place = autopilot, place
        self._services = services
        self._streams = self._first_streams()
        self._late_acks: dict[int, tuple[float, Any]] = {}
        self._texts = _Texts()
        self._groups: dict[int, float] = {}
        self._mode = autopilot.mode
        self._home = self._known_home
        self._has_no_peer, self._owes_origin = True, False
        self._sent_mode: tuple[tuple[str, str], float] = (("", ""), -math.inf)

    def can_send(self, kind: int) -> bool:
        """Whether the message exists."""
        if kind in self.autopilot.flavour.unknown_messages:
            return False
        return kind in MESSAGES or any(kind in service.messages for service in self._services)

    def withholds(self, kind: int) -> bool:
        """Whether a message is not available now: an unknown position, home or wind, a disabled fence."""
        pilot = self.autopilot
        match kind:
            case dialect.MAVLINK_MSG_ID_HOME_POSITION:
                return not has_home(pilot)
            case dialect.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN:
                return not has_origin(pilot)
            case dialect.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
                return pilot.gps_lost and not has_position(pilot)
            case dialect.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT:
                return goal_of(pilot) is None
            case dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED:
                return not sends_setpoint(pilot)
            case dialect.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT:
                # A rover sends this message only in automatic modes (ap-rover.c-speed).
                return not pilot.flies and pilot.role in (Role.MANUAL, Role.HOLD)
            case dialect.MAVLINK_MSG_ID_GIMBAL_MANAGER_STATUS:
                return pilot.payload.gimbal.is_secret
            case dialect.MAVLINK_MSG_ID_FENCE_STATUS:
                return not pilot.value(pilot.flavour.fence.enable)
            case dialect.MAVLINK_MSG_ID_WIND if not pilot.flies:
                # A rover needs a wind vane, and has none. A copter sends its wind from the first position on.
                return True
            case dialect.MAVLINK_MSG_ID_WIND_COV if not pilot.value("EKF2_DRAG_CTRL"):
                return True
        return kind in POSITIONS and not has_position(pilot)

    def find(self, kind: int) -> list[Any] | None:
        """The answer to a request for a message, possibly empty; None when it is refused."""
        for service in self._services:
            if kind in service.requests:
                return service.requests[kind]()
        return [self.build(kind)] if self.can_send(kind) and not self.withholds(kind) else None

    def build(self, kind: int) -> Any:
        """A message with present values. KeyError for an unknown one."""
        for service in self._services:
            if kind in service.messages:
                return service.messages[kind]()
        return MESSAGES[kind](self.autopilot, self.place)

    def stream(self, kind: int, rate: float) -> None:
        """Streams a message at a rate in Hz; 0 stops it, except for the heartbeat, which continues at 1 Hz.

        A message that is sent once, when it is known, is not a stream.
        """
        if kind not in self.autopilot.flavour.sent_once:
            self._streams.set(kind, rate, self.autopilot.now)

    def on_peer(self) -> None:
        """Handles a packet of a peer; PX4 sends the origin to the first one."""
        if self._has_no_peer and self.autopilot.flavour.sent_once:
            self._owes_origin = True
        self._has_no_peer = False

    def interval(self, kind: int) -> float:
        """Seconds between two messages of a stream; 0 when it is not streamed."""
        return self._streams.interval(kind)

    def default_rate(self, kind: int) -> float:
        """The default rate of a message in Hz: that of its group."""
        return self._groups.get(kind, self.autopilot.flavour.streams.get(kind, 0.0))

    def stream_group(self, kinds: Iterable[int], rate: float) -> None:
        """REQUEST_DATA_STREAM: streams messages at a rate."""
        for kind in filter(self.can_send, kinds):
            self._groups[kind] = rate
            self.stream(kind, rate)

    def acknowledge_later(self, command: int, ack: Any, seconds: float) -> None:
        """Sends a COMMAND_ACK of a MAV_CMD in some seconds."""
        self._late_acks[command] = (self.autopilot.now + seconds, ack)

    def is_late(self, command: int) -> bool:
        """Whether the acknowledgement of a MAV_CMD is pending."""
        return command in self._late_acks

    def due(self) -> list[Any]:
        """The messages for every peer now: acknowledgements, streams, texts."""
        now = self.autopilot.now
        messages = self._due_acks(now)
        due = self._streams.due(now)
        if self._mode_changed() and self.autopilot.flavour.sends_modes and HEARTBEAT not in due:
            due.append(HEARTBEAT)
        due += [kind for kind in self._home_messages() if kind not in due]
        messages += [self.build(kind) for kind in due if self._is_due(kind) and not self.withholds(kind)]
        for text in self.autopilot.pop_texts():
            messages += self._texts.messages(text, severity_of(text, rover=not self.autopilot.flies))
        return messages

    def _mode_changed(self) -> bool:
        before, self._mode = self._mode, self.autopilot.mode
        return before != self._mode

    @property
    def _known_home(self) -> Vector | None:
        return self.autopilot.home if has_home(self.autopilot) else None

    def _home_messages(self) -> list[int]:
        """Unrequested messages: ArduPilot's home when it is set, and the origin once."""
        before, self._home = self._home, self._known_home
        is_sent = self.autopilot.flavour.sends_home and self._home not in (before, None)
        owes = self._owes_origin or (is_sent and before is None)
        has_new_origin = owes and has_origin(self.autopilot)
        self._owes_origin = self._owes_origin and not has_new_origin
        return [GPS_GLOBAL_ORIGIN] * has_new_origin + [HOME_POSITION] * is_sent

    def _is_due(self, kind: int) -> bool:
        """Whether a message is due: CURRENT_MODE at a change, else twice a second."""
        if kind != CURRENT_MODE:
            return True
        pilot = self.autopilot
        mode = pilot.mode, pilot.intended
        if mode == self._sent_mode[0] and pilot.now - self._sent_mode[1] < MODE_PAUSE:
            return False
        self._sent_mode = mode, pilot.now
        return True

    def reboot(self) -> MavResult:
        """Restarts the autopilot and its services, unless the vehicle is armed."""
        result = self.autopilot.reboot()
        if result is MavResult.ACCEPTED:
            self._streams, self._late_acks = self._first_streams(), {}
            self._has_no_peer = True
            for service in self._services:
                service.reboot()
        return result

    def _first_streams(self) -> _Streams:
        rates = {k: rate for k, rate in self.autopilot.flavour.streams.items() if self.can_send(k)}
        return _Streams(rates, self.autopilot.now)

    def _due_acks(self, now: float) -> list[Any]:
        due = [command for command, (at, _) in self._late_acks.items() if now >= at]
        return [self._late_acks.pop(command)[1] for command in due]


class _Stream(Struct):
    interval: float
    due: float


class _Streams:
    """The streams of one vehicle, by message id. Times in seconds of the caller's clock."""

    def __init__(self, rates: Mapping[int, float], now: float) -> None:
        self._streams: dict[int, _Stream] = {}
        for kind, rate in {HEARTBEAT: 1.0, **rates}.items():
            self.set(kind, rate, now)

    def set(self, kind: int, rate: float, now: float) -> None:
        """Streams a message at a rate in Hz; 0 stops it, except for the heartbeat."""
        if kind == HEARTBEAT:
            rate = max(rate, 1.0)
        if rate <= 0.0:
            self._streams.pop(kind, None)
        else:
            self._streams[kind] = _Stream(1.0 / min(rate, MAX_RATE), now)

    def interval(self, kind: int) -> float:
        """Seconds between two messages of a stream; 0 when it is not streamed."""
        return self._streams[kind].interval if kind in self._streams else 0.0

    def due(self, now: float) -> list[int]:
        """The messages due now; each once after a pause, without a backlog."""
        due = [kind for kind, stream in self._streams.items() if now >= stream.due]
        for kind in due:
            stream = self._streams[kind]
            stream.due = max(stream.due + stream.interval, now)
        return due


class _Texts:
    """Numbers long texts."""

    def __init__(self) -> None:
        self._number = 0

    def messages(self, text: str, severity: int) -> list[Any]:
        """The STATUSTEXTs (253) of one text."""
        data = text.encode("ascii", "replace")
        if len(data) <= CHUNK:
            return [dialect.MAVLink_statustext_message(severity, data)]
        self._number = self._number % 0xFFFF + 1
        # A full last chunk does not end the text: an empty one must follow.
        chunks = [data[i : i + CHUNK] for i in range(0, len(data) + 1, CHUNK)]
        return [
            dialect.MAVLink_statustext_message(severity, chunk, self._number, index)
            for index, chunk in enumerate(chunks[:CHUNKS])
        ]

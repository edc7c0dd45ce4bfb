"""The links of a bus with their readers and writers, and the route to each vehicle."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

from msgspec import Struct

from lfield.driver import WireLog
from lfield_mavlink.link.dialect import Reader, Writer, dialect
from lfield_mavlink.link.links import Link
from lfield_mavlink.link.signing import LinkSigning, Signing
from lfield_mavlink.modes import STACKS

#: Seconds without a message after which a vehicle's other links are used.
LINK_TIMEOUT = 1.5
#: Packets stored per vehicle to detect copies: some seconds of all its streams.
REMEMBERED = 512
#: Stored names of other systems on the links.
MAX_NEIGHBOURS = 16
#: Seconds for which another station's command explains a vehicle's behaviour.
COMMAND_MEMORY = 3.0
#: Messages that move a vehicle: SET_MODE, MISSION_SET_CURRENT, COMMAND_INT and _LONG, setpoints.
COMMANDS = frozenset({11, 41, 75, 76, 82, 84, 86})
#: MAV_CMDs in the latter two that do: modes, positions, speeds, arming.
_LEADS = frozenset(
    {16, 17, 18, 20, 21, 22, 31, 34, 84, 85, 92, 115, 176, 177, 178, 185, 192, 193, 194, 195, 252, 300, 400}
)


class Port(Struct, frozen=True):
    """One link with its reader and writer, and the log of what it sends."""

    link: Link
    reader: Reader
    writer: Writer
    signing: LinkSigning | None
    wire_log: WireLog

    def send(self, message: Any, station: int, address: str = "") -> None:
        """Sends one message as a packet of a station, to an address behind the link, or ('') to all."""
        data = self.writer.pack(message, station)
        self.wire_log.log_mavlink(data)
        if address:
            self.link.send_to(data, address)
        else:
            self.link.send(data)


class LinkCounts(Struct, frozen=True):
    """Counters of the readers of all links: damaged packets, and signatures."""

    broken: int = 0
    good_signatures: int = 0
    bad_signatures: int = 0
    unsigned: int = 0

    @classmethod
    def total(cls, ports: Sequence[Port], signing: Signing | None) -> LinkCounts:
        """The present totals."""
        return cls(
            broken=sum(port.reader.broken for port in ports),
            good_signatures=signing.valid_count if signing else 0,
            bad_signatures=signing.invalid_count if signing else 0,
            unsigned=sum(port.signing.unsigned for port in ports if port.signing),
        )


#: MAV_TYPEs that are not vehicles: stations, companion computers, trackers, payloads.
_NO_VEHICLES = frozenset(
    {
        dialect.MAV_TYPE_ANTENNA_TRACKER,
        dialect.MAV_TYPE_GCS,
        dialect.MAV_TYPE_ONBOARD_CONTROLLER,
        dialect.MAV_TYPE_GIMBAL,
        dialect.MAV_TYPE_ADSB,
        dialect.MAV_TYPE_CAMERA,
        dialect.MAV_TYPE_CHARGING_STATION,
        dialect.MAV_TYPE_FLARM,
        dialect.MAV_TYPE_SERVO,
        dialect.MAV_TYPE_ODID,
        dialect.MAV_TYPE_BATTERY,
        dialect.MAV_TYPE_PARACHUTE,
        dialect.MAV_TYPE_LOG,
        dialect.MAV_TYPE_OSD,
        dialect.MAV_TYPE_IMU,
        dialect.MAV_TYPE_GPS,
        dialect.MAV_TYPE_WINCH,
        dialect.MAV_TYPE_ILLUMINATOR,
        dialect.MAV_TYPE_GRIPPER,
    }
)


def is_foreign(message: Any, autopilot: int) -> bool:
    """Whether a message is the heartbeat of a component that is not an autopilot.

    `autopilot` is the vehicle's MAV_AUTOPILOT, below 0 while unknown: ArduPilot or PX4 does not change its
    kind.
    """
    if message.get_msgId() != dialect.MAVLINK_MSG_ID_HEARTBEAT:
        return False
    if message.autopilot == dialect.MAV_AUTOPILOT_INVALID or message.type in _NO_VEHICLES:
        return True
    return autopilot in STACKS and message.autopilot not in STACKS


def foreign_text(message: Any) -> str:
    """`a gcs (MAV_TYPE 6, MAV_AUTOPILOT 8)`."""
    return f"a {_name('MAV_TYPE', message.type)} (MAV_TYPE {message.type}, MAV_AUTOPILOT {message.autopilot})"


class Neighbours:
    """Other systems on the links that send heartbeats and are not bound here.

    Also the last sender of a command to a vehicle, as seen through a router.
    """

    def __init__(self) -> None:
        self._names: dict[tuple[int, int], str] = {}
        self._commands: dict[int, tuple[int, int, float]] = {}

    def on_command(self, message: Any, now: float) -> None:
        """Handles a message of another system that may move a vehicle."""
        if getattr(message, "command", None) not in (None, *_LEADS):
            return
        sender = message.get_srcSystem(), message.get_srcComponent(), now
        self._commands[message.target_system] = sender
        if len(self._commands) > MAX_NEIGHBOURS:
            del self._commands[next(iter(self._commands))]

    def commander(self, system: int, now: float) -> str:
        """The recent commander of a vehicle, such as `system 77, component 1`; '' without one."""
        no_command = (0, 0, -math.inf)
        sender, component, at = max(
            (self._commands.get(n, no_command) for n in (system, 0)), key=lambda command: command[2]
        )
        return f"system {sender}, component {component}" if now - at <= COMMAND_MEMORY else ""

    def on_message(self, message: Any) -> None:
        """Handles a message of another system."""
        sender = message.get_srcSystem(), message.get_srcComponent()
        if message.get_msgId() != dialect.MAVLINK_MSG_ID_HEARTBEAT or sender in self._names:
            return
        if len(self._names) < MAX_NEIGHBOURS:
            description = [_name("MAV_TYPE", message.type), STACKS.get(message.autopilot, "")]
            self._names[sender] = ", ".join(filter(None, description))

    def __str__(self) -> str:
        """`system 1, component 1 (quadrotor, ArduPilot)`, for each; '' without any."""
        return "; ".join(
            f"system {system}, component {component} ({description})"
            for (system, component), description in sorted(self._names.items())
        )


def _name(group: str, number: int) -> str:
    entry = dialect.enums[group].get(number)
    if entry is None:
        return f"{group} {number}"
    name: str = entry.name.removeprefix(f"{group}_")
    return name.lower().replace("_", " ")


class Route:
    """The links of one vehicle by number.

    A link is used as long as messages of the vehicle arrive on it: setpoints on alternating links could be
    reordered.
    """

    def __init__(self, links: Sequence[int]) -> None:
        self._everywhere = tuple(links)
        self._last_packet: dict[int, float] = {}
        self._link: int | None = None
        self._packets: OrderedDict[bytes, int] = OrderedDict()

    def on_packet(self, link: int, packet: bytes | bytearray, now: float) -> bool:
        """Handles a packet from a link; returns whether it is new, not a copy from another link."""
        self._last_packet[link] = now
        if len(self._everywhere) == 1:
            return True
        packet = bytes(packet)
        first = self._packets.setdefault(packet, link)
        if len(self._packets) > REMEMBERED:
            self._packets.popitem(last=False)
        if first == link:
            # Equal bytes on the same link are not a copy: the sequence numbers have wrapped around.
            self._packets.move_to_end(packet)
        return first == link

    def links(self, now: float) -> Sequence[int]:
        """The numbers of the links to send on: the one on which messages of the vehicle arrive, or all if
        none arrive.
        """
        if self._link is None or now - self._last_packet[self._link] > LINK_TIMEOUT:
            newest = max(self._last_packet, key=self._last_packet.__getitem__, default=None)
            self._link = (
                newest if newest is not None and now - self._last_packet[newest] <= LINK_TIMEOUT else None
            )
        return self._everywhere if self._link is None else (self._link,)

"""The links of a bus with their readers and writers, and the one that a vehicle is reached on."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from lfield_mavlink.link.dialect import Reader, Writer, dialect
from lfield_mavlink.link.links import Link
from lfield_mavlink.link.signing import LinkSigning, Signing
from lfield_mavlink.modes import STACKS

#: Seconds without a message after which a vehicle is looked for on its other links.
STEADY = 1.5
#: Packets remembered per vehicle: some seconds of all its streams.
REMEMBERED = 512
#: Others on the links whose names are kept.
MOST_NEIGHBOURS = 16
#: Seconds for which a command of somebody else may be why a vehicle goes elsewhere.
JUST = 3.0
#: Messages that send a vehicle somewhere: SET_MODE, MISSION_SET_CURRENT, COMMAND_INT and _LONG, setpoints.
COMMANDS = frozenset({11, 41, 75, 76, 82, 84, 86})
#: MAV_CMDs that do, of those two: modes, places, speeds, arming.
_LEADS = frozenset(
    {16, 17, 18, 20, 21, 22, 31, 34, 84, 85, 92, 115, 176, 177, 178, 185, 192, 193, 194, 195, 252, 300, 400}
)


@dataclass(frozen=True, slots=True)
class Port:
    """One link with what reads and writes its packets."""

    link: Link
    reader: Reader
    writer: Writer
    signing: LinkSigning | None

    def send(self, message: Any, station: int, address: str = "") -> None:
        """One message as one packet of a station, to an address behind the link, or ('') to all."""
        data = self.writer.pack(message, station)
        if address:
            self.link.send_to(data, address)
        else:
            self.link.send(data)


@dataclass(frozen=True, slots=True)
class LinkCounts:
    """What the readers of all links have counted: damaged packets, and signatures."""

    broken: int = 0
    good_signatures: int = 0
    bad_signatures: int = 0
    unsigned: int = 0

    @classmethod
    def over(cls, ports: Sequence[Port], signing: Signing | None) -> LinkCounts:
        """What they have counted up to now."""
        return cls(
            broken=sum(port.reader.broken for port in ports),
            good_signatures=signing.good if signing else 0,
            bad_signatures=signing.bad if signing else 0,
            unsigned=sum(port.signing.unsigned for port in ports if port.signing),
        )


#: MAV_TYPEs of what is no vehicle: stations, companion computers, trackers, and all kinds of equipment.
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
    """Whether a message is the heartbeat of what is no autopilot: a station, a companion computer.

    `autopilot` is the vehicle's MAV_AUTOPILOT, below 0 as long as that is not known: one with ArduPilot or
    PX4 does not become one of another kind.
    """
    if message.get_msgId() != dialect.MAVLINK_MSG_ID_HEARTBEAT:
        return False
    if message.autopilot == dialect.MAV_AUTOPILOT_INVALID or message.type in _NO_VEHICLES:
        return True
    return autopilot in STACKS and message.autopilot not in STACKS


def foreign_words(message: Any) -> str:
    """`a gcs (MAV_TYPE 6, MAV_AUTOPILOT 8)`."""
    return f"a {_name('MAV_TYPE', message.type)} (MAV_TYPE {message.type}, MAV_AUTOPILOT {message.autopilot})"


class Neighbours:
    """Who is heard on the links by a heartbeat and is no vehicle that somebody here is bound to.

    Beside that, who was heard last to command a vehicle: a router, say, shows its messages to everybody.
    """

    def __init__(self) -> None:
        self._heard: dict[tuple[int, int], str] = {}
        self._commands: dict[int, tuple[int, int, float]] = {}

    def commanded(self, message: Any, now: float) -> None:
        """A message of somebody else, which may send a vehicle somewhere."""
        if getattr(message, "command", None) not in (None, *_LEADS):
            return
        who = message.get_srcSystem(), message.get_srcComponent(), now
        self._commands[message.target_system] = who
        if len(self._commands) > MOST_NEIGHBOURS:
            del self._commands[next(iter(self._commands))]

    def commander(self, system: int, now: float) -> str:
        """`system 77, component 1`, that has just commanded a vehicle; '' when nobody was heard to."""
        nobody = (0, 0, -math.inf)
        by, component, at = max((self._commands.get(n, nobody) for n in (system, 0)), key=lambda who: who[2])
        return f"system {by}, component {component}" if now - at <= JUST else ""

    def heard(self, message: Any) -> None:
        """A message of somebody else."""
        who = message.get_srcSystem(), message.get_srcComponent()
        if message.get_msgId() != dialect.MAVLINK_MSG_ID_HEARTBEAT or who in self._heard:
            return
        if len(self._heard) < MOST_NEIGHBOURS:
            words = [_name("MAV_TYPE", message.type), STACKS.get(message.autopilot, "")]
            self._heard[who] = ", ".join(filter(None, words))

    def __str__(self) -> str:
        """`system 1, component 1 (quadrotor, ArduPilot)`, each; '' when there are none."""
        return "; ".join(
            f"system {system}, component {component} ({words})"
            for (system, component), words in sorted(self._heard.items())
        )


def _name(group: str, number: int) -> str:
    entry = dialect.enums[group].get(number)
    if entry is None:
        return f"{group} {number}"
    name: str = entry.name.removeprefix(f"{group}_")
    return name.lower().replace("_", " ")


class Route:
    """The links of one vehicle by number.

    A link is kept while the vehicle is heard on it: setpoints that went out on two links in turn could
    overtake one another.
    """

    def __init__(self, links: int) -> None:
        self._everywhere = tuple(range(links))
        self._heard: dict[int, float] = {}
        self._link: int | None = None
        self._packets: OrderedDict[bytes, int] = OrderedDict()

    def heard(self, link: int, packet: bytes | bytearray, now: float) -> bool:
        """A packet came on a link; whether it is new, and not the copy of one that came on another link."""
        self._heard[link] = now
        if len(self._everywhere) == 1:
            return True
        packet = bytes(packet)
        first = self._packets.setdefault(packet, link)
        if len(self._packets) > REMEMBERED:
            self._packets.popitem(last=False)
        if first == link:
            # The same bytes on the same link are not a copy: the numbers of packets have come round.
            self._packets.move_to_end(packet)
        return first == link

    def links(self, now: float) -> Sequence[int]:
        """Where to send: the link that it is heard on, or all when it is heard on none."""
        if self._link is None or now - self._heard[self._link] > STEADY:
            newest = max(self._heard, key=self._heard.__getitem__, default=None)
            self._link = newest if newest is not None and now - self._heard[newest] <= STEADY else None
        return self._everywhere if self._link is None else (self._link,)

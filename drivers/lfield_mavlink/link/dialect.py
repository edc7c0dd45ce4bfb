"""MAVLink 2 by pymavlink: selects the dialect, and parses and builds packets.

The dialect is `all`: ArduPilot's with additions of PX4 such as CURRENT_MODE.

The dialect is imported by name: `pymavlink.mavutil` would select one by the environment and the received
data, and its `recv_match` discards every other message.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import all as dialect

from lfield_mavlink.link.layouts import SHORTEST, Layout
from lfield_mavlink.link.signing import LinkSigning

__all__ = [
    "AUTOPILOT",
    "COMPONENT",
    "Reader",
    "Writer",
    "dialect",
    "is_echo",
    "request_message",
    "result_text",
    "station_heartbeat",
]

#: Our component: an onboard computer. The system id depends on the vehicle (`station`).
COMPONENT = dialect.MAV_COMP_ID_ONBOARD_COMPUTER
#: The autopilot's component. pymavlink leaves the target component at 0 by default.
AUTOPILOT = dialect.MAV_COMP_ID_AUTOPILOT1

#: The parser keeps its input until its buffer is empty, which may never happen on a stream.
_MAX_BUFFER = 4096
#: Reason of pymavlink for a packet with a refused signature.
_REFUSED = "Invalid signature"
#: By message id.
_LAYOUTS = {number: Layout(kind) for number, kind in dialect.mavlink_map.items()}


def request_message(system: int, kind: int) -> Any:
    """COMMAND_LONG that requests one message of a kind from the autopilot of a system."""
    command, unused = dialect.MAV_CMD_REQUEST_MESSAGE, [0.0] * 6
    return dialect.MAVLink_command_long_message(system, AUTOPILOT, command, 0, float(kind), *unused)


def station_heartbeat(system: int) -> Any:
    """The heartbeat of a vehicle's station; it carries the vehicle's id, so that its echo can be
    recognised.
    """
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, system, dialect.MAV_STATE_ACTIVE, 3
    )


def is_echo(message: Any, system: int) -> bool:
    """Whether a heartbeat with a station's id is an echo of our own."""
    is_own_type = message.type == dialect.MAV_TYPE_GCS and message.get_srcComponent() == COMPONENT
    return bool(is_own_type and message.custom_mode == system)


class Header(NamedTuple):
    """Sender ids, message id and sequence number of a packet."""

    system: int
    component: int
    kind: int
    sequence: int


def _nothing_is_spare(_: Header) -> bool:
    return False


def _ignore_packet(_: bytes) -> None:
    """Packets that nothing logs."""


class Reader:
    """Parses the bytes of a link; broken packets and unknown messages are skipped.

    `broken` counts damaged packets. `on_packet` gets each packet, also one that is not decoded or has a
    refused signature. With `signing`, packets without a valid signature are skipped too, and counted there.
    """

    def __init__(
        self, signing: LinkSigning | None = None, on_packet: Callable[[bytes], None] = _ignore_packet
    ) -> None:
        self._parser: Any = dialect.MAVLink(None)
        self._on_packet = on_packet
        # Without this setting, one wrong checksum raises.
        self._parser.robust_parsing = True
        self._signed = signing is not None
        if signing is not None:
            signing.attach_reader(self._parser)
        self.broken = 0

    def feed(self, data: bytes, is_spare: Callable[[Header], bool] = _nothing_is_spare) -> Sequence[Any]:
        """The messages that these bytes complete; never raises.

        An unsigned packet that is all of `data` is not decoded when it `is_spare`.
        """
        if not self._is_plain(data):
            return self._parsed(data)
        self._on_packet(data)
        header = Header(data[5], data[6], data[7] | data[8] << 8 | data[9] << 16, data[4])
        layout = _LAYOUTS.get(header.kind)
        if layout is None or is_spare(header):
            return ()
        message = layout.message(data)
        if message is None:
            self.broken += 1
            return ()
        return (message,)

    def _is_plain(self, data: bytes) -> bool:
        """Whether these bytes are one whole unsigned packet, as most datagrams are; it needs no buffer."""
        return (
            len(data) >= SHORTEST
            and data[0] == dialect.PROTOCOL_MARKER_V2
            and len(data) == SHORTEST + data[1]
            and not (data[2] or self._signed or self._parser.buf)
        )

    def _parsed(self, data: bytes) -> list[Any]:
        parser, messages = self._parser, []
        for message in parser.parse_buffer(data) or ():
            if isinstance(message, dialect.MAVLink_bad_data):
                self.broken += message.reason != _REFUSED
                if message.reason != _REFUSED:
                    continue
            self._on_packet(bytes(message.get_msgbuf()))
            if not isinstance(message, dialect.MAVLink_unknown | dialect.MAVLink_bad_data):
                messages.append(message)
        if parser.buf_index > _MAX_BUFFER:
            parser.buf = parser.buf[parser.buf_index :]
            parser.buf_index = 0
        return messages


class Writer:
    """Builds packets of several systems, each with its own sequence numbers, signed if there is a key."""

    def __init__(self, signing: LinkSigning | None = None) -> None:
        self._mavlink: Any = dialect.MAVLink(None, srcComponent=COMPONENT)
        self._signing = signing
        self._sequences: dict[int, int] = {}

    def pack(self, message: Any, system: int) -> bytes:
        """One packet of a system."""
        layout, sequence = _LAYOUTS[message.get_msgId()], self._sequences.get(system, 0)
        if self._signing is None and layout.is_plain:
            data = layout.packet(message, sequence, system, COMPONENT)
        else:
            self._mavlink.srcSystem, self._mavlink.seq = system, sequence
            if self._signing is not None:
                self._signing.seal(self._mavlink)
            data = bytes(message.pack(self._mavlink))
        self._sequences[system] = (sequence + 1) % 256
        return data


def result_text(result: int) -> str:
    """`FAILED (4)`."""
    entry = dialect.enums["MAV_RESULT"].get(result)
    name = entry.name.removeprefix("MAV_RESULT_") if entry is not None else "unknown result"
    return f"{name} ({result})"

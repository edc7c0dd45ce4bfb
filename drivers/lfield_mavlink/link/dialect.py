"""MAVLink 2 by pymavlink: the one place where the dialect is chosen, and packets are read and made.

It is `all`: ArduPilot's dialect with what PX4 has beside it, such as CURRENT_MODE.

The dialect is imported by its name: `pymavlink.mavutil` would choose one by the environment and by what it
happens to receive, and its `recv_match` throws away every message it was not asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import all as dialect

from lfield_mavlink.link.layouts import SHORTEST, Layout
from lfield_mavlink.link.signing import LinkSigning

__all__ = ["AUTOPILOT", "COMPONENT", "Reader", "Writer", "dialect", "request_message", "result_words"]

#: What we are: a computer on board. Which system is said for each vehicle (`station`).
COMPONENT = dialect.MAV_COMP_ID_ONBOARD_COMPUTER
#: The autopilot's component. pymavlink leaves the target component at 0 unless told.
AUTOPILOT = dialect.MAV_COMP_ID_AUTOPILOT1

#: The parser keeps what it has read until its buffer is empty, which on a stream may be never.
_KEPT = 4096
#: What pymavlink says of a packet whose signature was not believed.
_REFUSED = "Invalid signature"
#: By message id.
_LAYOUTS = {number: Layout(kind) for number, kind in dialect.mavlink_map.items()}


def request_message(system: int, kind: int) -> Any:
    """COMMAND_LONG that asks the autopilot of a system for one message of a kind."""
    asks, rest = dialect.MAV_CMD_REQUEST_MESSAGE, [0.0] * 6
    return dialect.MAVLink_command_long_message(system, AUTOPILOT, asks, 0, float(kind), *rest)


class Header(NamedTuple):
    """The ids of a packet's sender, its kind and its number."""

    system: int
    component: int
    kind: int
    sequence: int


def _nothing_is_spare(_: Header) -> bool:
    return False


class Reader:
    """Bytes of a link to messages; broken packets and unknown messages are left out.

    `broken` counts the packets that were damaged on their way. With `signing`, packets that it does not
    believe are left out too; it counts them itself.
    """

    def __init__(self, signing: LinkSigning | None = None) -> None:
        self._parser: Any = dialect.MAVLink(None)
        # Without it one wrong checksum raises.
        self._parser.robust_parsing = True
        self._signed = signing is not None
        if signing is not None:
            signing.attach_reader(self._parser)
        self.broken = 0

    def feed(self, data: bytes, is_spare: Callable[[Header], bool] = _nothing_is_spare) -> Sequence[Any]:
        """The messages that these bytes complete; never raises.

        A packet that is all of `data`, and need not prove its sender, is not decoded when it `is_spare`.
        """
        if not self._is_plain(data):
            return self._parsed(data)
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
        """Whether these bytes are one packet, as most datagrams are, and unsigned: it needs no buffer."""
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
            elif not isinstance(message, dialect.MAVLink_unknown):
                messages.append(message)
        if parser.buf_index > _KEPT:
            parser.buf = parser.buf[parser.buf_index :]
            parser.buf_index = 0
        return messages


class Writer:
    """Messages of some systems to packets, numbered for each, and signed where there is a key."""

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


def result_words(result: int) -> str:
    """`FAILED (4)`."""
    entry = dialect.enums["MAV_RESULT"].get(result)
    name = entry.name.removeprefix("MAV_RESULT_") if entry is not None else "unknown result"
    return f"{name} ({result})"

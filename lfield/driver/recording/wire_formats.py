"""Entries of wire logs as bytes. Pure.

.tlog          MAVLink: microseconds since 1970 as 8 bytes, big endian, and one packet (mavlogdump,
               MAVExplorer, QGroundControl, Mission Planner)
.candump.log   CAN: a line of `candump -L`, with T for sent and R for received frames (can-utils, python-can)
.hex.log       any other bytes: a line of seconds since 1970, `>` for sent or `<` for received, and the
               bytes in hexadecimal
"""

from __future__ import annotations

import re
from struct import Struct

TLOG, CANDUMP, HEX = ".tlog", ".candump.log", ".hex.log"
#: The first line of a .hex.log.
HEX_HEADER = b"# lfield wire log 1: seconds since 1970, > sent or < received, bytes in hexadecimal\n"
#: MAVLink messages that contain keys or passwords, and are never logged: CHANGE_OPERATOR_CONTROL, AUTH_KEY,
#: SETUP_SIGNING and WIFI_CONFIG_AP.
SECRET_MESSAGES = frozenset({5, 7, 256, 299})
#: Flag of an error frame in the id of a candump line, and the class of errors for which python-can reads such
#: a frame.
_CAN_ERROR = 0x2000_0000 | 0x80
_MICROSECONDS = Struct(">Q")
_MAVLINK_2, _MAVLINK_1 = 0xFD, 0xFE
_UNPRINTABLE = re.compile(r"[^A-Za-z0-9_.-]")


def tlog_entry(time: float, packet: bytes) -> bytes:
    """One MAVLink packet; b"" for a packet that must not be logged."""
    if _message_id(packet) in SECRET_MESSAGES:
        return b""
    return _MICROSECONDS.pack(max(0, int(time * 1e6))) + packet


def _message_id(packet: bytes) -> int | None:
    """The message id of a packet of either version; None for other bytes."""
    if len(packet) >= 10 and packet[0] == _MAVLINK_2:
        return packet[7] | packet[8] << 8 | packet[9] << 16
    return packet[5] if len(packet) >= 6 and packet[0] == _MAVLINK_1 else None


def candump_line(
    time: float,
    channel: str,
    identifier: int,
    data: bytes,
    *,
    extended: bool,
    fd: bool,
    is_sent: bool,
    switch: bool = False,
) -> bytes:
    """One CAN frame; `switch` is the bit rate switch of CAN FD."""
    digits, flags = 8 if extended else 3, f"#{switch:d}" if fd else ""
    direction = "T" if is_sent else "R"
    return (
        f"({time:.6f}) {channel} {identifier:0{digits}X}#{flags}{data.hex().upper()} {direction}\n".encode()
    )


def candump_error(time: float, channel: str, identifier: int, data: bytes) -> bytes:
    """One error frame of a CAN interface; `identifier` contains its classes of errors."""
    return f"({time:.6f}) {channel} {_CAN_ERROR | identifier:08X}#{data.hex().upper()}\n".encode()


def channel_name(channel: str) -> str:
    """The name of a CAN channel in a log, without folders and credentials: `can0`, `ttyACM0`."""
    last = channel.rpartition("/")[2].rpartition("@")[2] if not channel.startswith("/") else channel[1:]
    name = _UNPRINTABLE.sub("_", last.rpartition("/")[2].partition("@")[0]) or "can0"
    return f"can{name}" if name.isdigit() else name


def hex_line(time: float, data: bytes, *, is_sent: bool) -> bytes:
    """Some bytes of a serial line."""
    return f"{time:.6f} {'>' if is_sent else '<'} {data.hex(' ').upper()}\n".encode()

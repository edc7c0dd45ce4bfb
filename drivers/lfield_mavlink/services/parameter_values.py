"""Encoding of parameters in the float of PARAM_VALUE and PARAM_SET.

ArduPilot casts: the integer 5 is sent as 5.0, so only integers that fit a 32-bit float survive. PX4 is
byte-wise: the four bytes are the integer. https://mavlink.io/en/services/parameter.html#parameter_encoding

The bytes are taken from the packet itself: converted to a float, an integer whose bytes are a signalling NaN
(such as -8388607) would be changed.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from enum import Enum
from typing import Any

from lfield_mavlink.link.dialect import AUTOPILOT, dialect

#: Offset of the payload by the packet's first byte (MAVLink 2, MAVLink 1); the value comes first.
_PAYLOAD = {0xFD: 10, 0xFE: 6}
#: Characters of a name, which is not terminated at full length.
NAME_LENGTH = 16

#: struct codes of the integer parameter types.
_INTEGERS: Mapping[int, str] = {
    dialect.MAV_PARAM_TYPE_UINT8: "B",
    dialect.MAV_PARAM_TYPE_INT8: "b",
    dialect.MAV_PARAM_TYPE_UINT16: "H",
    dialect.MAV_PARAM_TYPE_INT16: "h",
    dialect.MAV_PARAM_TYPE_UINT32: "I",
    dialect.MAV_PARAM_TYPE_INT32: "i",
}


class Encoding(Enum):
    """The encoding of integers in the float."""

    CAST = "cast"
    BYTEWISE = "bytewise"


def decode(raw: bytes, kind: int, encoding: Encoding) -> int | float | None:
    """The value in the four bytes; None if invalid (a cast integer that is not finite)."""
    number: float = struct.unpack("<f", raw)[0]
    if kind not in _INTEGERS:
        return number
    if encoding is Encoding.CAST:
        return int(number) if math.isfinite(number) else None
    code = _INTEGERS[kind]
    integer: int = struct.unpack("<" + code, raw[: struct.calcsize(code)])[0]
    return integer


def encode(value: float, kind: int, encoding: Encoding) -> bytes:
    """The four bytes of a value. Raises ValueError if it cannot be encoded exactly.

    A real is rounded to 32 bits, as in every autopilot.
    """
    if not math.isfinite(value):
        raise ValueError(f"{value} is not a value for a parameter")
    if kind not in _INTEGERS:
        return _as_float(value)
    if value != int(value):
        raise ValueError(f"it is an integer, not {value:g}")
    try:
        exact = struct.pack("<" + _INTEGERS[kind], int(value)).ljust(4, b"\0")
    except struct.error:
        bits = 8 * struct.calcsize(_INTEGERS[kind])
        raise ValueError(f"{int(value)} is out of range of its {bits} bits") from None
    if encoding is Encoding.BYTEWISE:
        return exact
    cast = _as_float(value)
    if struct.unpack("<f", cast)[0] != value:
        raise ValueError(
            f"{int(value)} cannot be sent exactly to this autopilot, which casts integers to float"
        )
    return cast


def raw_value(message: Any) -> bytes:
    """The four bytes of the value in a received PARAM_VALUE."""
    packet = message.get_msgbuf()
    start = _PAYLOAD[packet[0]]
    return bytes(packet[start : start + 4])


class _ParamSet(dialect.MAVLink_param_set_message):  # type: ignore[misc]  # pymavlink has no types
    """PARAM_SET with the value as four bytes."""

    unpacker = struct.Struct("<4sBB16sB")


def param_set(system: int, name: str, raw: bytes, kind: int) -> Any:
    """The PARAM_SET of an encoded value."""
    return _ParamSet(system, AUTOPILOT, name.encode(), raw, kind)


def _as_float(value: float) -> bytes:
    try:
        return struct.pack("<f", value)
    except OverflowError:
        raise ValueError(f"{value:g} is out of range of a 32-bit float") from None

"""How an autopilot puts a parameter into the one float of PARAM_VALUE and PARAM_SET.

ArduPilot casts: the integer 5 is sent as 5.0, so only integers that a 32-bit float can hold survive.
PX4 goes byte-wise: the four bytes are the integer. https://mavlink.io/en/services/parameter.html#parameter_encoding

The four bytes are taken from the packet itself: on its way through a float, an integer whose bytes happen
to be a signalling NaN (-8388607 is one) would come out changed.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from enum import Enum
from typing import Any

from lfield_mavlink.link.dialect import AUTOPILOT, dialect

#: Where the payload of a packet begins, by its first byte (MAVLink 2, MAVLink 1); the value comes first.
_PAYLOAD = {0xFD: 10, 0xFE: 6}
#: Characters of a name, which has no end mark when it is as long as that.
NAME_LENGTH = 16

#: struct codes of the parameter types that are integers; the float types are left out.
_INTEGERS: Mapping[int, str] = {
    dialect.MAV_PARAM_TYPE_UINT8: "B",
    dialect.MAV_PARAM_TYPE_INT8: "b",
    dialect.MAV_PARAM_TYPE_UINT16: "H",
    dialect.MAV_PARAM_TYPE_INT16: "h",
    dialect.MAV_PARAM_TYPE_UINT32: "I",
    dialect.MAV_PARAM_TYPE_INT32: "i",
}


class Encoding(Enum):
    """How integers are put into the float."""

    CAST = "cast"
    BYTEWISE = "bytewise"


def decode(raw: bytes, kind: int, encoding: Encoding) -> int | float | None:
    """The value in the four bytes; None when they are none (a cast integer that is not finite)."""
    number: float = struct.unpack("<f", raw)[0]
    if kind not in _INTEGERS:
        return number
    if encoding is Encoding.CAST:
        return int(number) if math.isfinite(number) else None
    code = _INTEGERS[kind]
    integer: int = struct.unpack("<" + code, raw[: struct.calcsize(code)])[0]
    return integer


def encode(value: float, kind: int, encoding: Encoding) -> bytes:
    """The four bytes of a value. Raises ValueError with a sentence when they cannot hold it exactly.

    A real number is rounded to 32 bits, as every autopilot keeps it.
    """
    if not math.isfinite(value):
        raise ValueError(f"{value} is no value for a parameter")
    if kind not in _INTEGERS:
        return _as_float(value)
    if value != int(value):
        raise ValueError(f"it is a whole number, not {value:g}")
    try:
        exact = struct.pack("<" + _INTEGERS[kind], int(value)).ljust(4, b"\0")
    except struct.error:
        bits = 8 * struct.calcsize(_INTEGERS[kind])
        raise ValueError(f"{int(value)} is out of the range of its {bits} bits") from None
    if encoding is Encoding.BYTEWISE:
        return exact
    cast = _as_float(value)
    if struct.unpack("<f", cast)[0] != value:
        raise ValueError(f"{int(value)} is not sent exactly by this autopilot, which casts integers to float")
    return cast


def raw_value(message: Any) -> bytes:
    """The four bytes of the value in a PARAM_VALUE as it came."""
    packet = message.get_msgbuf()
    start = _PAYLOAD[packet[0]]
    return bytes(packet[start : start + 4])


class _ParamSet(dialect.MAVLink_param_set_message):  # type: ignore[misc]  # pymavlink has no types
    """PARAM_SET with the value as the four bytes that they are."""

    unpacker = struct.Struct("<4sBB16sB")


def param_set(system: int, name: str, raw: bytes, kind: int) -> Any:
    """The PARAM_SET of an encoded value."""
    return _ParamSet(system, AUTOPILOT, name.encode(), raw, kind)


def _as_float(value: float) -> bytes:
    try:
        return struct.pack("<f", value)
    except OverflowError:
        raise ValueError(f"{value:g} is out of the range of a 32-bit float") from None

"""The messages of DroneCAN that are used here: layout, encoding and decoding (specification, 3. DSDL). Pure.

A number is written with its lowest eight bits first; each piece starts at the highest free bit of a byte.
Ids, signatures and fields are those of the standard data types in DSDL.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence

from msgspec import Struct

from lfield_can.drone_can.transfers import Transfer, TransferKind

Values = dict[str, float]


class DataType(Struct, frozen=True):
    """A data type: `fields` are names with `u`, `i` (two's complement) or `f` (IEEE 754) and their bits.

    Bytes that follow them are its last array.
    """

    id: int
    signature: int
    fields: Sequence[tuple[str, str]] = ()
    is_service: bool = False

    @property
    def kind(self) -> TransferKind:
        """The kind of transfer that carries messages of this type."""
        return TransferKind(self.id)


NODE_STATUS = DataType(
    341,
    0x0F0868D0C1A7C6F1,
    (("uptime", "u32"), ("health", "u2"), ("mode", "u3"), ("sub_mode", "u3"), ("vendor_code", "u16")),
)
ALLOCATION = DataType(1, 0x0B2A812620A11D40, (("node", "u7"), ("is_first", "u1")))
GET_NODE_INFO = DataType(1, 0xEE468A8121C46A9E, is_service=True)
ESC_STATUS = DataType(
    1034,
    0xA9AF28AEA2FBB254,
    (
        *(("error_count", "u32"), ("voltage", "f16"), ("current", "f16"), ("temperature", "f16")),
        *(("rpm", "i18"), ("power", "u7"), ("index", "u5")),
    ),
)
ACTUATOR_STATUS = DataType(
    1011,
    0x5E9BBA44FAF1EA04,
    (
        *(("index", "u8"), ("position", "f16"), ("force", "f16"), ("speed", "f16")),
        *(("_", "u1"), ("power", "u7")),
    ),
)
#: With a single command.
ACTUATOR_COMMAND = DataType(
    1010, 0xD8A7486238EC3AF3, (("index", "u8"), ("command_type", "u8"), ("value", "f16"))
)
BATTERY_INFO = DataType(
    1092,
    0x249C26548A711966,
    (
        *(("temperature", "f16"), ("voltage", "f16"), ("current", "f16"), ("average_power", "f16")),
        *(("remaining", "f16"), ("full", "f16"), ("hours_to_full", "f16"), ("flags", "u11")),
        *(("health", "u7"), ("charge", "u7"), ("charge_deviation", "u7"), ("index", "u8"), ("model", "u32")),
    ),
)
#: The types that are received in several frames.
RECEIVED = (ESC_STATUS, ACTUATOR_STATUS, BATTERY_INFO, GET_NODE_INFO, ALLOCATION)

#: `command_type` of an actuator: radians or metres.
POSITION = 1
HEALTH = ("ok", "warning", "error", "critical")
OPERATIONAL = 0
BATTERY_FLAGS: Mapping[int, str] = {
    1: "in use",
    2: "charging",
    4: "charged",
    8: "too hot",
    16: "too cold",
    32: "overload",
    64: "bad battery",
    128: "needs service",
    256: "fault of the battery management system",
}
#: Flags that are faults.
BATTERY_FAULTS = 0x1F8
KELVIN = 273.15

_FLOAT16_MAX = 65504.0


class NodeInfo(Struct, frozen=True):
    """The identity of a node; `unique_id` has 16 bytes."""

    name: str
    unique_id: bytes
    software: str


def signatures() -> dict[tuple[int, bool], int]:
    """The signatures of the types in RECEIVED, for an assembler."""
    return {(each.id, each.is_service): each.signature for each in RECEIVED}


def encode(data_type: DataType, values: Mapping[str, float], array: bytes = b"") -> bytes:
    """The data of a message; absent fields are 0."""
    bits = size = 0
    for name, form in data_type.fields:
        length = int(form[1:])
        raw = _raw(form, values.get(name, 0))
        size += length
        while length > 0:
            piece = min(8, length)
            bits, raw = bits << piece | raw & (1 << piece) - 1, raw >> piece
            length -= piece
    padding = -size % 8
    return (bits << padding).to_bytes((size + padding) // 8, "big") + array


def decode(data_type: DataType, data: bytes) -> tuple[Values, bytes] | None:
    """The values of a message and its last array; None if it is too short. Never raises."""
    size = sum(int(form[1:]) for _, form in data_type.fields)
    count = (size + 7) // 8
    if len(data) < count:
        return None
    bits, remaining = int.from_bytes(data[:count], "big"), 8 * count
    values: Values = {}
    for name, form in data_type.fields:
        length, raw, shift = int(form[1:]), 0, 0
        while length > 0:
            piece = min(8, length)
            remaining -= piece
            raw |= (bits >> remaining & (1 << piece) - 1) << shift
            shift, length = shift + piece, length - piece
        values[name] = _value(form, raw)
    return values, data[count:]


def node_info(transfer: Transfer) -> NodeInfo | None:
    """The answer to GetNodeInfo: status (7 bytes), software (15), hardware with certificate, name."""
    data = transfer.data
    if len(data) < 41:
        return None
    software = f"{data[7]}.{data[8]}"
    name = data[41 + data[40] :].decode("ascii", "replace")
    return NodeInfo("".join(c if c.isprintable() else "?" for c in name), data[24:40], software)


def _raw(form: str, value: float) -> int:
    if form == "f16":
        bounded = value if not math.isfinite(value) else max(-_FLOAT16_MAX, min(_FLOAT16_MAX, value))
        return int.from_bytes(struct.pack("<e", bounded), "little")
    return int(value) & (1 << int(form[1:])) - 1


def _value(form: str, raw: int) -> float:
    if form == "f16":
        return float(struct.unpack("<e", raw.to_bytes(2, "little"))[0])
    length = int(form[1:])
    return raw - (1 << length) if form[0] == "i" and raw >> length - 1 else raw

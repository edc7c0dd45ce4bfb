"""Parameter protocol, with each autopilot's encoding of integers.

Protocol: https://mavlink.io/en/services/parameter.html. PX4 puts the bytes of an integer into the float,
ArduPilot its value.

Parameters that the model does not use are in a table for each flavour and kind in the folder `tables`:
`name,type,value`. Names and types are those of the autopilots
(https://ardupilot.org/copter/docs/parameters.html,
https://docs.px4.io/main/en/advanced_config/parameter_reference.html); the selection is ours.
"""

from __future__ import annotations

import csv
import math
import struct
import zlib
from collections import deque
from collections.abc import Mapping
from enum import IntEnum
from functools import cache
from importlib.resources import files
from typing import Any

from msgspec import Struct
from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.services.service import VehicleService

#: List values sent per step of the model: 1500 a second.
PER_STEP = 30
#: ArduPilot looks up names at 10 Hz, and answers without an index.
LOOKUP_DELAY, NO_INDEX = 0.1, 65535
#: Pending names at most.
MAX_NAMES = 100


#: PX4's first list entry: a checksum of all others, by which a client detects changes.
HASH = "_HASH_CHECK"
#: Counters that ArduPilot sends when they change (ap-copter.g-mission).
COUNTERS = ("MIS_TOTAL", "FENCE_TOTAL", "RALLY_TOTAL")


class ParameterType(IntEnum):
    """The used values of MAV_PARAM_TYPE."""

    INT8 = 2
    INT16 = 4
    INT32 = 6
    REAL32 = 9

    @property
    def bounds(self) -> tuple[int, int]:
        """The range of an integer type."""
        bits = {ParameterType.INT8: 7, ParameterType.INT16: 15}.get(self, 31)
        return -(1 << bits), (1 << bits) - 1


class ParameterRow(Struct, frozen=True):
    """The type of a parameter, and its default value."""

    type: ParameterType
    value: float


@cache
def parameter_table(flavour: str, kind: str) -> Mapping[str, ParameterRow]:
    """The table of a flavour (`ardupilot`, `px4`) and a kind of vehicle (`copter`, `rover`), by name."""
    text = (files(__package__) / "tables" / f"{flavour}_{kind}.csv").read_text(encoding="ascii")
    return {
        row["name"]: ParameterRow(ParameterType[row["type"].upper()], float(row["value"]))
        for row in csv.DictReader(text.splitlines())
    }


class ParameterService(VehicleService):
    """The parameter protocol.

    An unknown name has no answer. A wrong type has none on PX4, and NaN has none on ArduPilot; PX4 accepts
    NaN and values beyond a parameter's range.
    """

    def __init__(self, autopilot: Autopilot, place: GeoOrigin) -> None:
        super().__init__(autopilot, place)
        table = parameter_table(autopilot.flavour.name, autopilot.kind.name)
        self._rows = table
        self._bytewise = autopilot.flavour.name == "px4"
        for name, row in table.items():
            autopilot.parameters.setdefault(name, row.value)
        self._names = sorted(autopilot.parameters)
        self._numbers = {name: number for number, name in enumerate(self._names)}
        self._listing: deque[str] = deque()
        self._requested: deque[tuple[float, str]] = deque(maxlen=MAX_NAMES)
        self._counted = {name: autopilot.parameters[name] for name in COUNTERS if name in self._numbers}
        self.handles = {
            dialect.MAVLINK_MSG_ID_PARAM_REQUEST_READ: self._on_request_read,
            dialect.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: self._on_request_list,
            dialect.MAVLINK_MSG_ID_PARAM_SET: self._on_set,
        }

    def advance(self, now: float) -> list[Any]:
        """Values of looked-up names, changed counters, and the next values of a list."""
        messages: list[Any] = []
        while self._requested and now >= self._requested[0][0]:
            messages.append(self._value(self._requested.popleft()[1], named=True))
        for name, previous in self._counted.items():
            if (count := self.autopilot.parameters[name]) != previous:
                self._counted[name] = count
                messages.append(self._value(name, named=True))
        listed = [self._listing.popleft() for _ in range(min(PER_STEP, len(self._listing)))]
        return messages + [self._value(name) for name in listed]

    def reboot(self) -> None:
        """Ends a running list; values stay."""
        self._listing.clear()
        self._requested.clear()

    def _on_request_read(self, message: Any) -> list[Any]:
        name, number = message.param_id, message.param_index
        if number >= 0:
            name = self._names[number] if number < len(self._names) else ""
        elif name == HASH and self._bytewise:
            return [self._hash()]
        if name not in self._numbers:
            return []
        if number < 0 and not self._bytewise:
            self._requested.append((self.autopilot.now + LOOKUP_DELAY, name))
            return []
        return [self._value(name)]

    def _on_request_list(self, _: Any) -> list[Any]:
        self._listing = deque(self._names)
        return [self._hash()] if self._bytewise else []

    def _on_set(self, message: Any) -> list[Any]:
        name = message.param_id
        if name not in self._numbers:
            return []
        kind = self._row(name).type
        if self._bytewise and message.param_type != kind:
            return []
        value = self._decoded(message.param_value, kind)
        if not self._bytewise and not math.isfinite(value):
            return []
        changed = self.autopilot.parameters[name] != value
        self.autopilot.parameters[name] = value
        self.autopilot.apply_parameters()
        # PX4 answers, and then broadcasts the change.
        answers = [self._value(name, named=True)]
        return answers * 2 if self._bytewise and changed else answers

    def _row(self, name: str) -> ParameterRow:
        return self._rows.get(name, ParameterRow(ParameterType.REAL32, 0.0))

    def _value(self, name: str, *, named: bool = False) -> Any:
        """PARAM_VALUE 22; `named`: requested or set by name."""
        kind, number = self._row(name).type, self._numbers[name]
        if named and not self._bytewise:
            number = NO_INDEX
        value = self._encoded(self.autopilot.parameters[name], kind)
        return dialect.MAVLink_param_value_message(name.encode(), value, kind, len(self._names), number)

    def _hash(self) -> Any:
        """PX4's checksum, which has no index and its own type."""
        values = (f"{name}={self.autopilot.parameters[name]!r}" for name in self._names)
        number = zlib.crc32(" ".join(values).encode())
        value: float = struct.unpack("<f", struct.pack("<I", number))[0]
        kind = dialect.MAV_PARAM_TYPE_UINT32
        return dialect.MAVLink_param_value_message(HASH.encode(), value, kind, len(self._names), NO_INDEX)

    def _encoded(self, value: float, kind: ParameterType) -> float:
        if kind is ParameterType.REAL32 or not self._bytewise:
            return value
        encoded: float = struct.unpack("<f", struct.pack("<i", int(value)))[0]
        return encoded

    def _decoded(self, value: float, kind: ParameterType) -> float:
        """A received value, rounded and limited for an integer type."""
        if kind is ParameterType.REAL32:
            return value
        if self._bytewise:
            return float(struct.unpack("<i", struct.pack("<f", value))[0])
        lowest, highest = kind.bounds
        return float(min(max(int(value), lowest), highest)) if math.isfinite(value) else math.nan

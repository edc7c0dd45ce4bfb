"""Bit layout of signals in a message, and their physical values. Pure.

Bits are numbered as in DBC files: bit 0 is the lowest of byte 0, bit 8 the lowest of byte 1. The start of an
Intel signal is its lowest bit, that of a Motorola signal its highest. Signals may overlap.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from msgspec import Struct

#: Bytes of the longest frame, and lengths of CAN FD frames beyond 8 bytes (ISO 11898-1).
LONGEST, FD_LENGTHS = 64, (12, 16, 20, 24, 32, 48, 64)
#: Bytes of the longest classic frame.
LONGEST_CLASSIC = 8
#: IEEE 754 by length in bits: `struct` format and greatest value.
FLOATS: Mapping[int, tuple[str, float]] = {
    16: ("e", 65504.0),
    32: ("f", struct.unpack("<f", b"\xff\xff\x7f\x7f")[0]),
    64: ("d", math.inf),
}
#: Relative rounding of range ends, which tools write with six digits.
ROUNDING = 5e-6


class OutOfRange(ValueError):
    """A value that a signal cannot represent; the message is a sentence."""


class Signal(Struct, frozen=True):
    """One signal. `minimum` and `maximum` are None if the file gives no range ([0|0]).

    `multiplexer_ids` are the values of `multiplexer_signal` with which it is in its message.
    """

    name: str
    start: int
    length: int
    is_motorola: bool = False
    is_signed: bool = False
    is_float: bool = False
    scale: float = 1.0
    offset: float = 0.0
    minimum: float | None = None
    maximum: float | None = None
    unit: str = ""
    is_multiplexer: bool = False
    multiplexer_signal: str | None = None
    multiplexer_ids: Sequence[range] = ()

    @property
    def first(self) -> int:
        """The first bit of the signal; for Motorola bits are counted from the highest of each byte."""
        return self.start ^ 7 if self.is_motorola else self.start

    @property
    def end(self) -> int:
        """The number of bits up to the end of the signal: the least length of its message."""
        return self.first + self.length

    def is_selected(self, raw: Mapping[str, int | float]) -> bool:
        """Whether the multiplexer values select the signal."""
        if self.multiplexer_signal is None:
            return True
        value = raw.get(self.multiplexer_signal)
        return value is not None and any(value in ids for ids in self.multiplexer_ids)

    def extract(self, data: bytes) -> int | float:
        """The raw value of the signal in sufficiently long data."""
        if self.is_motorola:
            bits = int.from_bytes(data, "big") >> 8 * len(data) - self.end
        else:
            bits = int.from_bytes(data, "little") >> self.start
        bits &= (1 << self.length) - 1
        if self.is_float:
            size = self.length // 8
            number: float = struct.unpack(f">{FLOATS[self.length][0]}", bits.to_bytes(size, "big"))[0]
            return number
        return bits - (1 << self.length) if self.is_signed and bits >> self.length - 1 else bits

    def insert(self, raw: int | float, size: int) -> tuple[int, int]:
        """A raw value as bits of a message of `size` bytes, and their mask, as Intel numbers."""
        if self.is_float:
            bits = int.from_bytes(struct.pack(f">{FLOATS[self.length][0]}", raw), "big")
        else:
            bits = int(raw) & (1 << self.length) - 1
        mask = (1 << self.length) - 1
        if not self.is_motorola:
            return bits << self.start, mask << self.start
        shift = 8 * size - self.end
        return _swap_byte_order(bits << shift, size), _swap_byte_order(mask << shift, size)

    def to_physical(self, raw: int | float) -> float:
        """The value in the unit of the file."""
        return raw * self.scale + self.offset

    def to_raw(self, value: float) -> int | float:
        """The nearest raw value. Raises OutOfRange: not finite, outside its range or its bits."""
        if not math.isfinite(value):
            raise OutOfRange(f"{self.name} requires a finite number, not {value}")
        smallest, largest = representable(self)
        lowest = smallest if self.minimum is None else max(smallest, self.minimum)
        highest = largest if self.maximum is None else min(largest, self.maximum)
        # The nearest representable value applies at the ends as well. A range end in the file is
        # representable, or rounded to a few digits.
        low_tolerance = self._step if lowest == smallest else self._rounding(lowest)
        high_tolerance = self._step if highest == largest else self._rounding(highest)
        if not lowest - low_tolerance <= value <= highest + high_tolerance:
            unit = f" {self.unit}" if self.unit else ""
            raise OutOfRange(
                f"{self.name} cannot be {value:.12g}{unit}: its range is {lowest:.12g} to "
                f"{highest:.12g}{unit}"
            )
        return self._nearest(min(max(value, lowest), highest))

    @property
    def _step(self) -> float:
        """The distance of a value to the nearest representable one."""
        return 0.0 if self.is_float else 0.5 * abs(self.scale)

    def _rounding(self, end: float) -> float:
        """The tolerance of a range end."""
        share = ROUNDING * abs(end)
        return share if self.is_float else min(share, self._step)

    def _nearest(self, value: float) -> int | float:
        """The nearest raw value for one within its range."""
        raw = (value - self.offset) / self.scale
        if self.is_float:
            limit = FLOATS[self.length][1]
            return min(max(raw, -limit), limit)
        low, high = self.raw_range
        return min(max(round(raw), low), high)

    @property
    def raw_range(self) -> tuple[int, int]:
        """The lowest and highest integer of the bits of the signal."""
        if self.is_signed:
            return -(1 << self.length - 1), (1 << self.length - 1) - 1
        return 0, (1 << self.length) - 1


def representable(signal: Signal) -> tuple[float, float]:
    """The lowest and highest value of the bits of a signal."""
    limit = FLOATS[signal.length][1] if signal.is_float else 0.0
    ends = (-limit, limit) if signal.is_float else signal.raw_range
    lowest, highest = sorted(signal.to_physical(end) for end in ends)
    return lowest, highest


@dataclass(frozen=True)
class Message:
    """One message: its id, its length in bytes, and its signals in bit order."""

    name: str
    frame_id: int
    length: int
    signals: Sequence[Signal] = ()
    is_extended_frame: bool = False
    is_fd: bool = False
    #: Whether the data are sent at the second bit rate of CAN FD.
    is_switched: bool = False
    #: Seconds between two frames, as the file says; 0 if it does not.
    cycle: float = 0.0
    #: Whether the message is a SAE J1939 parameter group, with any priority and sender.
    is_j1939: bool = False
    #: Signals of the file that do not fit a frame, with the reasons.
    unusable: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def size(self) -> int:
        """Bytes of a frame of the message: CAN FD frames are padded to a valid length."""
        return next((size for size in (self.length, *FD_LENGTHS) if _is_length(size, self.length)), LONGEST)

    def decode(self, data: bytes) -> dict[str, float]:
        """The values in these bytes by signal; signals beyond the data are absent."""
        raw = self._raw(data)
        return {
            signal.name: signal.to_physical(raw[signal.name]) for signal in self.signals if signal.name in raw
        }

    def problem(self, data: bytes) -> str:
        """The defects of a frame with this data; '' for a valid frame."""
        problems = []
        kind = f"frame 0x{self.frame_id:X}"
        raw = self._raw(data)
        if len(data) < self.length:
            missing = [s.name for s in self.signals if s.end > 8 * len(data) and _may_contain(s, raw)]
            suffix = f": signal{'s' * (len(missing) != 1)} {', '.join(missing)} absent" if missing else ""
            problems.append(f"{kind} has {_bytes(len(data))}, the file specifies {self.length}{suffix}")
        for signal in self.signals:
            if signal.is_multiplexer and signal.name in raw and not self._is_known(signal, raw[signal.name]):
                problems.append(
                    f"{kind} has {raw[signal.name]} in {signal.name}, which selects no signal of {self.name}"
                )
        return "; ".join(problems)

    def encode(self, values: Mapping[str, float]) -> bytes:
        """The bytes of the message with these values; of multiplexed signals, the selected ones.

        Raises OutOfRange, and KeyError with the name of a missing signal.
        """
        raw: dict[str, int | float] = {}
        bits = 0
        for signal in self._in_order:
            if not signal.is_selected(raw):
                continue
            raw[signal.name] = signal.to_raw(values[signal.name])
            part, mask = signal.insert(raw[signal.name], self.size)
            bits = bits & ~mask | part
        return bits.to_bytes(self.size, "little")

    @cached_property
    def _in_order(self) -> Sequence[Signal]:
        """The signals, multiplexers before the signals that they select."""
        ordered: list[Signal] = []
        names: set[str | None] = {None}
        remaining = list(self.signals)
        while ready := [signal for signal in remaining if signal.multiplexer_signal in names]:
            ordered += ready
            remaining = [signal for signal in remaining if signal.multiplexer_signal not in names]
            names.update(signal.name for signal in ready)
        return tuple(ordered)

    def _raw(self, data: bytes) -> dict[str, int | float]:
        raw: dict[str, int | float] = {}
        for signal in self._in_order:
            if signal.end <= 8 * len(data) and signal.is_selected(raw):
                raw[signal.name] = signal.extract(data)
        return raw

    def _is_known(self, multiplexer: Signal, value: int | float) -> bool:
        """Whether a multiplexer value selects any signal; True for every value if none ever does."""
        selected = [s for s in self.signals if s.multiplexer_signal == multiplexer.name]
        return not selected or any(value in ids for s in selected for ids in s.multiplexer_ids)


def _may_contain(signal: Signal, raw: Mapping[str, int | float]) -> bool:
    """Whether a signal is in the message; True if its multiplexer is absent too."""
    return signal.multiplexer_signal not in raw or signal.is_selected(raw)


def _swap_byte_order(bits: int, size: int) -> int:
    """Converts a number between Motorola and Intel order."""
    return int.from_bytes(bits.to_bytes(size, "big"), "little")


def _is_length(size: int, minimum: int) -> bool:
    return size >= minimum and (size <= LONGEST_CLASSIC or size in FD_LENGTHS)


def _bytes(count: int) -> str:
    return f"{count} byte{'s' * (count != 1)}"

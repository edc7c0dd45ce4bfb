"""Supervision of a command by its receiver: counter, checksum and deadline, as in control units. Pure.

A frame with a wrong checksum, or whose counter is unchanged or has jumped by more than MAX_JUMP, is not
used. After MAX_ERRORS of them in a row, or without a good frame for MAX_LATE periods, communication has
failed, until QUALIFYING good frames follow each other. CRCs are those of crccheck.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from operator import xor
from typing import Literal

from cantools.database.can import Message, Signal
from crccheck.crc import Crc8Autosar, Crc8GsmA, Crc8SaeJ1850, Crc16Autosar
from msgspec import Struct

from lfield.errors import UsageError

#: Lost frames that are tolerated, plus one; wrong frames in a row; periods without a good frame.
MAX_JUMP, MAX_ERRORS, MAX_LATE = 3, 3, 5
#: Good frames in a row after a failure.
QUALIFYING = 2


def _nibble_sum(identifier: int, data: bytes) -> int:
    digits = f"{identifier:08X}{data.hex()}"
    return (8 + 3 * (identifier > 0x7FF) - sum(int(digit, 16) for digit in digits)) % 16


#: Checksums by name: the id of the frame, its bytes without the checksum, data ids, counter, length.
_SUMS: Mapping[str, Callable[[int, bytes, Sequence[int], int, int], int]] = {
    "xor8": lambda _, rest, *__: reduce(xor, rest, 0),
    "sum8": lambda _, rest, *__: sum(rest) % 256,
    "crc8_j1850": lambda _, rest, *__: int(Crc8SaeJ1850.calc(rest)),
    "crc8_h2f": lambda _, rest, *__: int(Crc8Autosar.calc(rest)),
    "e2e_1": lambda _, rest, ids, *__: int(Crc8GsmA.calc(_little(ids[0]) + rest)),
    "e2e_2": lambda _, rest, ids, counter, __: int(Crc8Autosar.calc(rest + bytes([ids[counter]]))),
    "e2e_5": lambda _, rest, ids, *__: int(Crc16Autosar.calc(rest + _little(ids[0]))),
    "honda": lambda identifier, rest, *_: _nibble_sum(identifier, rest),
    "toyota": lambda identifier, rest, _, __, length: (
        (sum(identifier.to_bytes(4, "big")) + sum(rest) + length) % 256
    ),
}


def _little(number: int) -> bytes:
    return number.to_bytes(2, "little")


class Supervision(Struct):
    """One message: its protecting signals, and as a receiver the state of its communication.

    `period` is 0 without a deadline.
    """

    message: Message
    counter: str = ""
    values: int = 0
    checksum: str = ""
    kind: str = ""
    ids: tuple[int, ...] = ()
    period: float = 0.0
    sent: int = -1
    last: int | None = None
    errors: int = 0
    good_frames: int = 0
    age: float = 0.0
    failed: bool = True

    def next_count(self) -> int:
        """The counter of the next frame to be sent."""
        self.sent = (self.sent + 1) % self.values if self.values else 0
        return self.sent

    def stamped(self, data: bytes, counter: int) -> bytes:
        """A frame to be sent with its checksum, whose bits are 0 so far."""
        if not self.checksum:
            return data
        first, count = self._place()
        value = self._sum(data, counter)
        if self.kind == "honda":
            value = data[first] | value << self._signal.start % 8 // 4 * 4
        return data[:first] + value.to_bytes(count, _order(self._signal)) + data[first + count :]

    def is_accepted(self, data: bytes, counter: int) -> bool:
        """Whether a received frame is used."""
        if self._is_wrong(data, counter):
            self.good_frames, self.errors = 0, self.errors + 1
            self.failed = self.failed or self.errors >= MAX_ERRORS
            return False
        self.errors, self.age, self.good_frames = 0, 0.0, self.good_frames + 1
        self.failed = self.failed and self.good_frames < QUALIFYING
        return not self.failed

    def step(self, dt: float) -> None:
        """Advances time by `dt` seconds."""
        self.age += dt
        if self.period and self.age > MAX_LATE * self.period:
            self.failed, self.good_frames = True, 0

    def _is_wrong(self, data: bytes, counter: int) -> bool:
        last, self.last = self.last, counter
        if self.checksum:
            first, count = self._place()
            received_sum = int.from_bytes(data[first : first + count], _order(self._signal))
            if self.kind == "honda":
                received_sum = received_sum >> self._signal.start % 8 // 4 * 4 & 0xF
            if received_sum != self._sum(data, counter):
                return True
        if not self.counter or last is None:
            return False
        return counter >= self.values or not 1 <= (counter - last) % self.values <= MAX_JUMP

    def _sum(self, data: bytes, counter: int) -> int:
        first, count = self._place()
        data = data[: self.message.length]
        neighbour = b""
        if self.kind == "honda":
            neighbour = bytes([data[first] & (0xF0 if self._signal.start % 8 < 4 else 0x0F)])
        protected = data[:first] + neighbour + data[first + count :]
        return _SUMS[self.kind](self.message.frame_id, protected, self.ids, counter, len(data))

    @property
    def _signal(self) -> Signal:
        return self.message.get_signal_by_name(self.checksum)

    def _place(self) -> tuple[int, int]:
        """The first byte of the checksum, and the number of its bytes."""
        return self._signal.start // 8, (self._signal.length + 7) // 8


def _order(signal: Signal) -> Literal["big", "little"]:
    return "big" if signal.byte_order == "big_endian" else "little"


def supervisions(
    messages: Mapping[str, Message], counters: str, checksums: str, cycles: str
) -> dict[str, Supervision]:
    """The supervisions in the texts of a device, by message: `Command.Counter:15`,
    `Command.Check:e2e_1/0x123` and `Command:0.02`, several joined by +. Raises UsageError.
    """
    supervisions_by_message: dict[str, Supervision] = {}

    def supervision_of(name: str) -> Supervision:
        message, _, signal = name.partition(".")
        if message not in messages or (signal and signal not in messages[message].signal_tree):
            raise UsageError(f"'{name}' is not in the file")
        return supervisions_by_message.setdefault(message, Supervision(messages[message]))

    for name, values in _pairs(counters):
        supervision = supervision_of(name)
        supervision.counter = name.partition(".")[2]
        supervision.values = int(
            values or 1 << supervision.message.get_signal_by_name(supervision.counter).length
        )
    for name, text in _pairs(checksums):
        kind, *ids = text.split("/")
        if kind not in _SUMS:
            raise UsageError(f"'{kind}' is not a checksum; there are {', '.join(_SUMS)}")
        supervision = supervision_of(name)
        supervision.checksum, supervision.kind = name.partition(".")[2], kind
        supervision.ids = tuple(int(each, 0) for each in ids)
    for name, period in _pairs(cycles):
        supervision_of(name).period = float(period or (messages[name].cycle_time or 0) / 1000.0)
    return supervisions_by_message


def _pairs(texts: str) -> list[tuple[str, str]]:
    return [text.partition(":")[::2] for text in texts.split("+") if text]

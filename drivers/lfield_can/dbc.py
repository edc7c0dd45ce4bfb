"""A DBC file through `cantools`, with range checks of our own. Pure: values in, bytes out, and the reverse.

cantools checks a range only where the file gives one; many files give [0|0], which is none, and then a value
that does not fit into its bits escapes as an OverflowError.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import cantools
from cantools.database.can import Database, Message, Signal

from lfield_can.bus.frames import EXTENDED, Frame

_TERM = re.compile(r"\s*(\w+)\.(\w+)\s*=\s*([-+0-9.eE]+)\s*(?:within\s+([0-9.eE+-]+)\s*)?")


class DbcError(ValueError):
    """A name that is not in the file, or a value that no frame can carry; the message is a sentence."""


@dataclass(frozen=True, slots=True)
class Term:
    """`Motor.speed=0 within 0.5`: a value of a signal, and how far off it may be."""

    message: str
    signal: str
    value: float
    within: float = 0.0


class DbcFile:
    """The messages of one file, but containers."""

    def __init__(self, path: str) -> None:
        try:
            # Not strict: half of all files in use overlap somewhere.
            database = cantools.database.load_file(path, strict=False)
        except Exception as error:  # whatever a parser of foreign text raises
            words = str(error).splitlines()[:1] or [type(error).__name__]
            raise DbcError(f"{path} cannot be read: {words[0]}") from None
        if not isinstance(database, Database):
            raise DbcError(f"{path} describes no CAN messages")
        self._by_name = {m.name: m for m in database.messages if not m.is_container}
        self._by_key = {_key(message): message for message in self._by_name.values()}

    @property
    def names(self) -> list[str]:
        """All messages."""
        return list(self._by_name)

    def key(self, message: str) -> int:
        """The key of its frames. Raises DbcError."""
        return _key(self.message(message))

    def message(self, name: str) -> Message:
        """A message by its name. Raises DbcError."""
        if name not in self._by_name:
            raise DbcError(f"the DBC file has no message '{name}'; it has {', '.join(sorted(self._by_name))}")
        return self._by_name[name]

    def signal(self, message: str, name: str) -> Signal:
        """A signal of a message. Raises DbcError."""
        signals = {signal.name: signal for signal in self.message(message).signals}
        if name not in signals:
            raise DbcError(f"{message} has no signal '{name}'; it has {', '.join(signals)}")
        return signals[name]

    def split(self, text: str) -> tuple[str, str]:
        """`Message.Signal` as two names that the file has. Raises DbcError."""
        message, dot, signal = text.partition(".")
        if not dot:
            raise DbcError(f"'{text}' is not written as Message.Signal")
        self.signal(message, signal)
        return message, signal

    def terms(self, texts: Iterable[str]) -> list[Term]:
        """What options say about signals. Raises DbcError."""
        found = []
        for text in texts:
            match = _TERM.fullmatch(text)
            if match is None:
                raise DbcError(f"'{text}' is not written as Message.Signal=VALUE [within VALUE]")
            self.signal(match[1], match[2])
            found.append(Term(match[1], match[2], _number(match[3]), _number(match[4] or "0")))
        return found

    def decode(self, frame: Frame) -> tuple[str, dict[str, float]] | None:
        """A frame's message and values; None for what the file does not explain. Never raises."""
        message = self._by_key.get(frame.key)
        if message is None:
            return None
        try:
            values = message.decode_simple(frame.data, decode_choices=False)
        except Exception:  # DecodeError, KeyError of an unknown multiplexer value, errors of bitstruct
            return None
        # A float signal may hold what is no value.
        numbers = {name: float(value) for name, value in values.items() if isinstance(value, int | float)}
        return message.name, {name: value for name, value in numbers.items() if math.isfinite(value)}

    def encode(self, name: str, values: Mapping[str, float]) -> Frame:
        """A message with these values; of multiplexed ones, those that are selected. Raises DbcError."""
        message = self.message(name)
        for signal, value in values.items():
            check_range(self.signal(name, signal), value)
        try:
            wanted = message.gather_signals({**values})
            data = message.encode(wanted, scaling=True, strict=False)
        except Exception as error:  # EncodeError for what is missing, KeyError, errors of bitstruct
            missing = [s.name for s in message.signals if s.name not in values and not s.multiplexer_ids]
            reason = f"it needs {', '.join(missing)} too" if missing else str(error).strip("'\"")
            raise DbcError(f"{name} cannot be sent: {reason}") from None
        return Frame(message.frame_id, data, message.is_extended_frame, message.is_fd)

    def selectors(self, message: str, signal: str) -> dict[str, float]:
        """The values of the multiplexers under which a signal is in its message."""
        found: dict[str, float] = {}
        this = self.signal(message, signal)
        while this.multiplexer_signal and this.multiplexer_ids and this.multiplexer_signal not in found:
            selector = self.signal(message, this.multiplexer_signal)
            found[selector.name] = this.multiplexer_ids[0] * float(selector.scale) + float(selector.offset)
            this = selector
        return found


def check_range(signal: Signal, value: float) -> None:
    """Raise DbcError unless the signal can carry the value: its range in the file, and its bits."""
    if not math.isfinite(value):
        raise DbcError(f"{signal.name} needs a finite number, not {value}")
    lowest, highest = representable(signal)
    if signal.minimum is not None:
        lowest = max(lowest, float(signal.minimum))
    if signal.maximum is not None:
        highest = min(highest, float(signal.maximum))
    if not lowest <= value <= highest:
        unit = f" {signal.unit}" if signal.unit else ""
        raise DbcError(f"{signal.name} cannot be {value:g}{unit}: it is from {lowest:g} to {highest:g}{unit}")


def representable(signal: Signal) -> tuple[float, float]:
    """The lowest and highest value that the bits of a signal can hold."""
    if signal.conversion.is_float:
        limit = {16: 65504.0, 32: struct.unpack("<f", b"\xff\xff\x7f\x7f")[0]}.get(signal.length, math.inf)
        raw = (-limit, limit)
    elif signal.is_signed:
        raw = (-(2.0 ** (signal.length - 1)), 2.0 ** (signal.length - 1) - 1.0)
    else:
        raw = (0.0, 2.0**signal.length - 1.0)
    lowest, highest = sorted(edge * float(signal.scale) + float(signal.offset) for edge in raw)
    return lowest, highest


def _key(message: Message) -> int:
    return message.frame_id | EXTENDED if message.is_extended_frame else message.frame_id


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise DbcError(f"'{text}' is not a number")
    return value

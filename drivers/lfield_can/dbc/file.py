"""A DBC file: its messages by name and by the key of their frames, and values checked before they are sent.

The file is read once, when the driver opens. A range is checked by what the file says and by the bits of the
signal: many files give [0|0], which is none.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from lfield.driver import Diagnostic, Diagnostics, Source, read_within
from lfield_can.bus.frames import EXTENDED, Frame, group_of
from lfield_can.dbc.layout import Message, OutOfRange, Signal
from lfield_can.dbc.reader import read_messages
from lfield_can.files import decode_text

#: The largest file, in bytes.
MOST_BYTES = 64 << 20
#: Mistakes that an error shows; the rest is counted.
SHOWN = 3

_TERM = re.compile(r"\s*([^.=]+)\.([^=]+?)\s*=\s*([-+0-9.eE]+)\s*(?:within\s+([0-9.eE+-]+)\s*)?")


class DbcError(ValueError):
    """A file that cannot be used, a name that is not in it, or a value that no frame can carry.

    The message is a sentence; `findings` are the mistakes in a file, with their places.
    """

    def __init__(self, text: str, findings: Sequence[Diagnostic] = ()) -> None:
        self.findings = tuple(findings)
        super().__init__(text)


@dataclass(frozen=True, slots=True)
class Term:
    """`Motor.speed=0 within 0.5`: a value of a signal, and how far off it may be."""

    message: str
    signal: str
    value: float
    within: float = 0.0


class DbcFile:
    """The messages of one file. Raises DbcError for one that cannot be read or used.

    `warnings` are what of it is not used, with the places.
    """

    def __init__(self, path: str) -> None:
        try:
            data = read_within(Path(path), MOST_BYTES)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise DbcError(f"{path} cannot be read: {reason}") from None
        found = Diagnostics()
        messages = read_messages(Source(path, decode_text(data)), found)
        if errors := found.errors:
            raise DbcError(f"{path} cannot be read: {_in_words(errors)}", errors)
        self.warnings: Sequence[Diagnostic] = tuple(found.in_order())
        self._by_name = {message.name: message for message in messages}
        self._by_key = {_key(message): message for message in messages}
        self._by_key.update({group_of(m.frame_id): m for m in messages if m.is_j1939})

    @property
    def names(self) -> list[str]:
        """All messages."""
        return list(self._by_name)

    def key(self, message: str) -> int:
        """The key of its frames, or of their parameter group where it is one of J1939. Raises DbcError."""
        found = self.message(message)
        return group_of(found.frame_id) if found.is_j1939 else _key(found)

    def find(self, frame: Frame) -> Message | None:
        """The message that a frame is, or None."""
        if (message := self._by_key.get(frame.key)) is None and frame.extended:
            message = self._by_key.get(group_of(frame.id))
        return message

    def message(self, name: str) -> Message:
        """A message by its name. Raises DbcError."""
        if name not in self._by_name:
            raise DbcError(f"the DBC file has no message '{name}'; it has {', '.join(sorted(self._by_name))}")
        return self._by_name[name]

    def signal(self, message: str, name: str) -> Signal:
        """A signal of a message. Raises DbcError."""
        found = self.message(message)
        signals = {signal.name: signal for signal in found.signals}
        if name in found.unusable:
            raise DbcError(f"{message}.{name} cannot be used: {found.unusable[name]}")
        if name not in signals:
            raise DbcError(f"{message} has no signal '{name}'; it has {', '.join(signals) or 'none'}")
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
        """A frame's message and the values that are in it; None for what the file does not explain.

        A frame that is shorter than the file says has the signals that lie in its bytes. Never raises.
        """
        message = self.find(frame)
        if message is None:
            return None
        # A float signal may hold what is no value.
        values = message.decode(frame.data).items()
        return message.name, {name: value for name, value in values if math.isfinite(value)}

    def problem(self, frame: Frame) -> str:
        """What is wrong with a frame of a message, in words: too short, or an unknown page; '' if not."""
        message = self.find(frame)
        return "" if message is None else message.problem(frame.data)

    def encode(self, name: str, values: Mapping[str, float]) -> Frame:
        """A message with these values; of multiplexed ones, those that are selected. Raises DbcError."""
        message = self.message(name)
        for given in values:
            self.signal(name, given)
        try:
            for signal in message.signals:
                if signal.name in values:
                    signal.to_raw(values[signal.name])
            data = message.encode(values)
        except OutOfRange as error:
            raise DbcError(str(error)) from None
        except KeyError as error:
            missing = [s.name for s in message.signals if s.name not in values and not s.multiplexer_ids]
            names = ", ".join(missing) or error.args[0]
            raise DbcError(f"{name} cannot be sent: it needs {names} too") from None
        return Frame(message.frame_id, data, message.is_extended_frame, message.is_fd)

    def selectors(self, message: str, signal: str) -> dict[str, float]:
        """The values of the multiplexers under which a signal is in its message."""
        found: dict[str, float] = {}
        this = self.signal(message, signal)
        while this.multiplexer_signal and this.multiplexer_ids and this.multiplexer_signal not in found:
            selector = self.signal(message, this.multiplexer_signal)
            found[selector.name] = selector.to_physical(this.multiplexer_ids[0].start)
            this = selector
        return found


def _in_words(errors: Sequence[Diagnostic]) -> str:
    """The first mistakes of a file, each with its place and what to do, and how many more there are."""
    shown = [
        f"{error.span.source.name}:{error.span.line}:{error.span.column}: "
        f"error[{error.code}]: {error.message} ({error.hint})"
        for error in errors[:SHOWN]
    ]
    more = len(errors) - len(shown)
    return "; ".join([*shown, f"and {more} more mistakes"] if more else shown)


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

"""A DBC file: messages by name and by frame key, with values checked before they are sent.

The file is read once, when the driver opens. Values are checked against the range in the file and the bits of
the signal: many files give [0|0], which means none.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from msgspec import Struct

from lfield.driver import Diagnostic, Diagnostics, Source, read_within
from lfield_can.bus.frames import EXTENDED, Frame, group_of
from lfield_can.dbc.dbc_reader import read_messages
from lfield_can.dbc.layout import Message, OutOfRange, Signal
from lfield_can.text_files import decode_text

#: The largest file, in bytes.
MAX_BYTES = 64 << 20
#: Mistakes shown in an error; the others are counted.
MAX_SHOWN = 3

_TERM = re.compile(r"\s*([^.=]+)\.([^=]+?)\s*=\s*([-+0-9.eE]+)\s*(?:within\s+([0-9.eE+-]+)\s*)?")


class DbcError(ValueError):
    """An unusable file, an unknown name, or a value that does not fit a frame.

    The message is a sentence; `findings` are the mistakes in a file, with their positions.
    """

    def __init__(self, text: str, findings: Sequence[Diagnostic] = ()) -> None:
        self.findings = tuple(findings)
        super().__init__(text)


class Term(Struct, frozen=True):
    """`Motor.speed=0 within 0.5`: a value of a signal, with a tolerance."""

    message: str
    signal: str
    value: float
    within: float = 0.0


class DbcFile:
    """The messages of one file. Raises DbcError for an unusable file.

    `warnings` are its ignored parts, with their positions.
    """

    def __init__(self, path: str) -> None:
        try:
            data = read_within(Path(path), MAX_BYTES)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise DbcError(f"{path} cannot be read: {reason}") from None
        diagnostics = Diagnostics()
        messages = read_messages(Source(path, decode_text(data)), diagnostics)
        if errors := diagnostics.errors:
            raise DbcError(f"{path} cannot be read: {_summary(errors)}", errors)
        self.warnings: Sequence[Diagnostic] = tuple(diagnostics.in_order())
        self._by_name = {message.name: message for message in messages}
        self._by_key = {_key(message): message for message in messages}
        self._by_key.update({group_of(m.frame_id): m for m in messages if m.is_j1939})

    @property
    def names(self) -> list[str]:
        """All messages."""
        return list(self._by_name)

    def key(self, message: str) -> int:
        """The key of the frames of a message, or of its J1939 parameter group. Raises DbcError."""
        definition = self.message(message)
        return group_of(definition.frame_id) if definition.is_j1939 else _key(definition)

    def find(self, frame: Frame) -> Message | None:
        """The message of a frame, or None."""
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
        definition = self.message(message)
        signals = {signal.name: signal for signal in definition.signals}
        if name in definition.unusable:
            raise DbcError(f"{message}.{name} cannot be used: {definition.unusable[name]}")
        if name not in signals:
            raise DbcError(f"{message} has no signal '{name}'; it has {', '.join(signals) or 'none'}")
        return signals[name]

    def reserve(self, message: str, reasons: Mapping[str, str]) -> None:
        """Makes signals of a sent message unusable for programs, for the given reasons. Raises DbcError."""
        definition = self.message(message)
        remaining = [signal for signal in definition.signals if signal.name not in reasons]
        self._by_name[message] = replace(
            definition, signals=remaining, unusable={**definition.unusable, **reasons}
        )

    def split(self, text: str) -> tuple[str, str]:
        """Splits `Message.Signal` into two known names. Raises DbcError."""
        message, dot, signal = text.partition(".")
        if not dot:
            raise DbcError(f"'{text}' does not have the form Message.Signal")
        self.signal(message, signal)
        return message, signal

    def terms(self, texts: Iterable[str]) -> list[Term]:
        """The terms in options. Raises DbcError."""
        terms = []
        for text in texts:
            match = _TERM.fullmatch(text)
            if match is None:
                raise DbcError(f"'{text}' does not have the form Message.Signal=VALUE [within VALUE]")
            self.signal(match[1], match[2])
            terms.append(Term(match[1], match[2], _number(match[3]), _number(match[4] or "0")))
        return terms

    def decode(self, frame: Frame) -> tuple[str, dict[str, float]] | None:
        """The message of a frame and its values; None for an unknown frame.

        A frame that is too short has the signals within its bytes. Never raises.
        """
        message = self.find(frame)
        if message is None:
            return None
        # A float signal may hold NaN.
        values = message.decode(frame.data).items()
        return message.name, {name: value for name, value in values if math.isfinite(value)}

    def problem(self, frame: Frame) -> str:
        """The defect of a frame: too short, or an unknown page; '' for a valid or unknown frame."""
        message = self.find(frame)
        return "" if message is None else message.problem(frame.data)

    def encode(self, name: str, values: Mapping[str, float]) -> Frame:
        """A message with these values; of multiplexed signals, the selected ones. Raises DbcError."""
        message = self.message(name)
        for signal_name in values:
            self.signal(name, signal_name)
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
            raise DbcError(f"{name} cannot be sent without {names}") from None
        return Frame(message.frame_id, data, message.is_extended_frame, message.is_fd, message.is_switched)

    def selectors(self, message: str, signal: str) -> dict[str, float]:
        """The multiplexer values under which a signal is in its message."""
        values: dict[str, float] = {}
        selected = self.signal(message, signal)
        while (
            selected.multiplexer_signal
            and selected.multiplexer_ids
            and selected.multiplexer_signal not in values
        ):
            selector = self.signal(message, selected.multiplexer_signal)
            values[selector.name] = selector.to_physical(selected.multiplexer_ids[0].start)
            selected = selector
        return values


def _summary(errors: Sequence[Diagnostic]) -> str:
    """The first mistakes of a file with positions and hints, and the number of others."""
    texts = [
        f"{error.span.source.name}:{error.span.line}:{error.span.column}: "
        f"error[{error.code}]: {error.message} ({error.hint})"
        for error in errors[:MAX_SHOWN]
    ]
    others = len(errors) - len(texts)
    return "; ".join([*texts, f"and {others} more mistakes"] if others else texts)


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

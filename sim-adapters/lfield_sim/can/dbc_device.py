"""A device of a DBC file: command signals drive status signals. Pure.

A status signal follows the command signal of the same name, ignoring words like Target, Command and Actual
(TargetWidth and Width), as a first-order lag within the signal's range. Single bits and signals with named
values follow immediately. Multiplexed and container messages are omitted.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import cantools
from cantools.database.can import Message, Signal
from msgspec import Struct, field
from msgspec.structs import replace

from lfield.errors import BindingError, InputFileError, UsageError
from lfield.text.input_files import error_reason
from lfield_sim.can.can_bus import CanFrame, FaultLookup
from lfield_sim.can.can_motor import AMBIENT, OVERHEATED
from lfield_sim.can.command_supervision import Supervision, supervisions
from lfield_sim.state_log import Facts

#: Default period of status messages in seconds.
PERIOD = 0.1
_COMMAND_TERMS = frozenset({"target", "command", "cmd", "set", "setpoint", "desired", "demand", "goal"})
_STATUS_TERMS = frozenset({"actual", "status", "measured", "feedback", "present", "is"})
_FAULT_TERMS, _HEAT_TERMS = frozenset({"fault", "error"}), frozenset({"temperature", "temp"})
_DRIVE_FAULTS = ("overcurrent", "overheat", "follow_error")

#: Bit 31 of an id marks 29 bits; many files omit it.
_EXTENDED, _STANDARD, _LONGEST = 1 << 31, 0x7FF, 0x1FFFFFFF
_MESSAGE = re.compile(r"[ \t]*BO_[ \t]+(\d+)")
_SIGNAL = re.compile(r"[ \t]*SG_[ \t]+([^\s:]+)")
_VALUES = re.compile(r'^[ \t]*VAL_[ \t]+(\d+)[ \t]+(\S+)(?:"[^"]*"|[^";])*;', re.MULTILINE)
_ID = re.compile(
    r'^([ \t]*(?:BO_|VAL_|SIG_VALTYPE_|SG_MUL_VAL_|BO_TX_BU_|(?:CM_|BA_ "\w+") (?:BO_|SG_))[ \t]+)(\d+)',
    re.MULTILINE,
)

#: Message and signal.
SignalName = tuple[str, str]


class DbcData(Struct, frozen=True):
    """Pairs of signals; `lag` and `timeout` in seconds (0: commands do not expire). `supervised` are messages
    with a counter, a checksum or a deadline.
    """

    messages: Mapping[int, Message]
    own: tuple[Message, ...]
    links: Mapping[SignalName, SignalName]
    lag: float = 0.3
    timeout: float = 0.0
    supervised: Mapping[str, Supervision] = field(default_factory=dict)


class DbcDevice:
    """The device (see `bus_world.BusDevice`)."""

    def __init__(self, name: str, flaw: FaultLookup, data: DbcData) -> None:
        self._name, self._flaw, self._data = name, flaw, data
        self._reset()

    @property
    def id(self) -> str:
        """The name of the file of the device."""
        return self._name

    def power_up(self) -> list[CanFrame]:
        """Restarts with initial values."""
        self._reset()
        return []

    def power_down(self) -> None:
        """Discards the commands; the device keeps its state."""
        self._commanded.clear()

    def value(self, message: str, signal: str) -> float:
        """The present value of a status signal."""
        return self._values[message, signal]

    def on_frame(self, frame: CanFrame) -> list[CanFrame]:
        """Receives a frame: a command, or a request for a status message."""
        message = self._data.messages.get(_key(frame.identifier, frame.extended))
        if message is None or frame.error:
            return []
        if frame.remote:
            return [self._message(message)] if message in self._data.own else []
        if message not in self._data.own and len(frame.data) >= message.length:
            values: Any = message.decode(frame.data, decode_choices=False)
            supervision = self._supervised.get(message.name)
            counter = int(values.get(supervision.counter, 0)) if supervision is not None else 0
            if supervision is None or supervision.is_accepted(frame.data, counter):
                self._on_command(message.name, values)
        return []

    def step(self, dt: float) -> list[CanFrame]:
        """Advances time; returns the status messages that are due."""
        self._command_age += dt
        if self._data.timeout and self._command_age > self._data.timeout:
            self._commanded.clear()
        for supervision in self._supervised.values():
            supervision.step(dt)
        refused = any(
            supervision.failed
            for supervision in self._supervised.values()
            if supervision.message not in self._data.own
        )
        if refused:
            self._commanded.clear()
        tripped = refused or any(self._flaw(name) for name in _DRIVE_FAULTS)
        for message in self._data.own:
            for signal in message.signals:
                self._move((message.name, signal.name), signal, tripped, dt)
        due = [message for message in self._data.own if self._is_due(message, dt)]
        is_silent = self._flaw("lost_tpdo") or self._flaw("lost_heartbeat")
        return [] if is_silent else [self._message(message) for message in due]

    def facts(self) -> Facts:
        """The commands, in thousandths."""
        return {f"{m}.{s}": round(1000.0 * value) for (m, s), value in self._commanded.items()}

    def _reset(self) -> None:
        self._values = {(m.name, s.name): _initial(s) for m in self._data.own for s in m.signals}
        self._since = dict.fromkeys((message.name for message in self._data.own), 0.0)
        self._commanded: dict[SignalName, float] = {}
        self._command_age = 0.0
        self._supervised = {name: replace(supervision) for name, supervision in self._data.supervised.items()}

    def _on_command(self, message: str, values: Mapping[str, Any]) -> None:
        for signal, value in values.items():
            if math.isfinite(value):
                self._commanded[message, signal] = float(value)
                self._command_age = 0.0

    def _move(self, key: SignalName, signal: Signal, tripped: bool, dt: float) -> None:
        terms = _terms(signal.name)
        if terms & _HEAT_TERMS:
            goal = OVERHEATED if self._flaw("overheat") else AMBIENT
            self._values[key] = _within(signal, goal)
        elif terms & _FAULT_TERMS:
            self._values[key] = _within(signal, float(tripped))
        elif key in self._data.links and not self._flaw("stuck"):
            self._follow(key, signal, tripped, dt)

    def _follow(self, key: SignalName, signal: Signal, tripped: bool, dt: float) -> None:
        """Follows the command; without one, or tripped, a signal stays, and single bits reset."""
        command = None if tripped else self._commanded.get(self._data.links[key])
        at_once = signal.length == 1 or bool(signal.choices)
        if at_once:
            self._values[key] = _within(signal, _initial(signal) if command is None else command)
        elif command is not None:
            goal, value = _within(signal, command), self._values[key]
            self._values[key] = value + (goal - value) * -math.expm1(-dt / self._data.lag)

    def _is_due(self, message: Message, dt: float) -> bool:
        period = (message.cycle_time or 0) / 1000.0 or PERIOD
        self._since[message.name] += dt
        if self._since[message.name] < period - 1e-9:
            return False
        self._since[message.name] = 0.0
        return True

    def _message(self, message: Message) -> CanFrame:
        raw = {
            signal.name: _raw(signal, self._values[message.name, signal.name]) for signal in message.signals
        }
        supervision = self._supervised.get(message.name)
        count = supervision.next_count() if supervision is not None else 0
        if supervision is not None:
            raw.update({supervision.counter: count} if supervision.counter else {})
            raw.update({supervision.checksum: 0} if supervision.checksum else {})
        data = message.encode(raw, scaling=False, strict=False)
        if supervision is not None:
            data = supervision.stamped(data, count)
        return CanFrame(
            message.frame_id,
            data,
            extended=message.is_extended_frame,
            fd=message.is_fd,
            switch=message.is_fd and _attribute(message, "CANFD_BRS") == 1,
        )


def load(
    file: str,
    *,
    node: str = "",
    commands: str = "",
    command: str = "",
    status: str = "",
    counters: str = "",
    checksums: str = "",
    cycles: str = "",
) -> DbcData:
    """The device of a DBC file. Raises UsageError, InputFileError, and BindingError for an invalid file.

    The device is `node`, or all messages except `commands` (names joined by +), or the sender of the signal
    `status` driven by the signal `command`; else the only node that sends no signal called a command.
    `counters`, `checksums` and `cycles` are as in `supervisions`.
    """
    try:
        text = _repaired(_decoded(Path(file).read_bytes()))
        # Not strict: signals of many files overlap, or exceed their frames.
        database: Any = cantools.database.load_string(text, database_format="dbc", strict=False)
    except OSError as error:
        raise InputFileError(file, error_reason(error)) from None
    except Exception as error:  # cantools raises exceptions of its parsers
        problem = str(error).split("\n")[0]
        raise BindingError([f"{file} cannot be read as a DBC file: {problem}"]) from None
    plain = [m for m in database.messages if not m.is_multiplexed() and _can_be_sent(m)]
    links = {_place(plain, status): _place(plain, command)} if command or status else {}
    if commands:
        own = [m for m in plain if m.name not in commands.split("+")]
    else:
        node = node or (_sender(plain, status) if links else _device(file, plain))
        own = [m for m in plain if node in m.senders]
    if not own:
        raise UsageError(f"{file} has no message that the device '{node}' sends")
    by_key = {_key(m.frame_id, m.is_extended_frame): m for m in plain}
    supervised = supervisions({m.name: m for m in plain}, counters, checksums, cycles)
    return DbcData(by_key, tuple(own), links or _links(plain, own), supervised=supervised)


def _can_be_sent(message: Message) -> bool:
    """Whether the signals of a message fit its frame without overlap."""
    if message.is_container:
        return False
    try:
        data = message.encode(
            dict.fromkeys((s.name for s in message.signals), 0), scaling=False, strict=False
        )
    except Exception:  # exceptions of cantools' packer
        return False
    return len(data) == message.length and all(_end(signal) <= 8 * len(data) for signal in message.signals)


def _end(signal: Signal) -> int:
    """The end of a signal in bits, in byte order."""
    start = signal.start ^ 7 if signal.byte_order == "big_endian" else signal.start
    return start + signal.length


def _attribute(message: Message, name: str) -> Any:
    """The number of an attribute of a message; None if the file has none."""
    attribute = message.dbc.attributes.get(name) if message.dbc is not None else None
    return attribute.value if attribute is not None else None


def _key(identifier: int, extended: bool) -> int:
    return identifier | extended << 31


@cache
def _terms(name: str) -> frozenset[str]:
    """Splits `TargetWidth` and `target_width` into words."""
    return frozenset(term.lower() for term in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+", name))


def _links(messages: Iterable[Message], own: list[Message]) -> dict[SignalName, SignalName]:
    """Every signal of the device with the matching command signal."""
    commands = {
        _terms(s.name) - _COMMAND_TERMS: (m.name, s.name) for m in messages if m not in own for s in m.signals
    }
    keys = [(m.name, s.name) for m in own for s in m.signals]
    terms_by_key = [(key, _terms(key[1]) - _STATUS_TERMS) for key in keys]
    return {key: commands[terms] for key, terms in terms_by_key if terms in commands}


def _senders(messages: Iterable[Message]) -> list[str]:
    return sorted({sender for message in messages for sender in message.senders})


def _device(file: str, messages: list[Message]) -> str:
    """The only node that sends no signal called a command."""
    commanding = {
        sender
        for m in messages
        for sender in m.senders
        if any(_terms(s.name) & _COMMAND_TERMS for s in m.signals)
    }
    candidates = [sender for sender in _senders(messages) if sender not in commanding]
    if len(candidates) != 1:
        raise UsageError(
            f"{file} does not define which node is the device; add commands=MESSAGE+MESSAGE, or node=NAME of "
            f"{', '.join(_senders(messages)) or 'none: it names no senders'}"
        )
    return candidates[0]


def _sender(messages: Iterable[Message], status: str) -> str:
    message = next(m for m in messages if m.name == status.partition(".")[0])
    if not message.senders:
        raise UsageError(f"{message.name} has no sender; add node=NAME or commands=MESSAGE+MESSAGE")
    return str(message.senders[0])


def _place(messages: Iterable[Message], text: str) -> SignalName:
    """`Message.Signal`. Raises UsageError."""
    for message in messages:
        for signal in message.signals:
            if text == f"{message.name}.{signal.name}":
                return message.name, signal.name
    raise UsageError(
        f"'{text}' is not a signal of the file; write command=Message.Signal,status=Message.Signal"
    )


@cache
def _bounds(signal: Signal) -> tuple[float, float]:
    """The raw range of a signal."""
    if signal.is_float:
        return -1e30, 1e30
    bits = signal.length
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if signal.is_signed else (0, (1 << bits) - 1)


def _raw(signal: Signal, value: float) -> float:
    """The raw value on the wire."""
    low, high = _bounds(signal)
    raw = max(low, min(high, (value - float(signal.offset)) / float(signal.scale)))
    return raw if signal.is_float else round(raw)


def _within(signal: Signal, value: float) -> float:
    """A value within the range of the file and of the signal's bits."""
    bounds = [bound * float(signal.scale) + float(signal.offset) for bound in _bounds(signal)]
    low, high = min(bounds), max(bounds)
    minimum, maximum = signal.minimum, signal.maximum
    if minimum is not None and maximum is not None and minimum < maximum:
        low, high = max(low, float(minimum)), min(high, float(maximum))
    return max(low, min(high, value))


def _initial(signal: Signal) -> float:
    initial: Any = signal.initial
    return _within(signal, float(initial or 0.0))


def _decoded(data: bytes) -> str:
    """The text of a file: UTF-8 with or without a mark, or the encoding of Vector's tools."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def _repaired(text: str) -> str:
    """The text without value names of missing signals, and with bit 31 in every id that needs it."""
    signals, message = set(), ""
    for line in text.splitlines():
        if match := _MESSAGE.match(line):
            message = match[1]
        elif match := _SIGNAL.match(line):
            signals.add((message, match[1]))
    text = _VALUES.sub(lambda match: match[0] if (match[1], match[2]) in signals else "", text)
    return _ID.sub(lambda match: match[1] + _with_bit(int(match[2])), text)


def _with_bit(identifier: int) -> str:
    return str(identifier | _EXTENDED if _STANDARD < identifier <= _LONGEST else identifier)

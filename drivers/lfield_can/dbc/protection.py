"""The counter and the checksum of a message, written into sent frames and checked in received ones. Pure.

A binding names the signals: `counters: [Command.Counter=15]` (15 values, 0 to 14; by default all of its bits)
and `checksums: [Command.Check=e2e_1 0x123]` (a kind of checksums.py, and its data ids).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from msgspec import Struct

from lfield_can.dbc.checksums import KINDS, Covered
from lfield_can.dbc.dbc_file import DbcError, DbcFile
from lfield_can.dbc.layout import Message, Signal

_COUNTER = re.compile(r"\s*([^.=]+)\.([^=\s]+)\s*(?:=\s*([0-9]{1,9})\s*)?")
_CHECKSUM = re.compile(
    r"\s*([^.=]+)\.([^=\s]+)\s*=\s*(\w+)((?:[\s,]+(?:0[xX][0-9a-fA-F]{1,4}|[0-9]{1,5}))*)\s*"
)


class _Draft(Struct):
    """The protection of one message, as far as it was read."""

    counter: Signal | None = None
    values: int = 0
    checksum: Signal | None = None
    kind: str = ""
    ids: tuple[int, ...] = ()


class Protection:
    """The counter and checksum of one message."""

    def __init__(self, message: Message, draft: _Draft) -> None:
        self._message, self._draft = message, draft
        self._next = 0
        self._last: int | None = None

    @property
    def signals(self) -> Mapping[str, str]:
        """The protecting signals, with the reason why a program cannot set them."""
        counter, checksum = self._draft.counter, self._draft.checksum
        reasons = {counter.name: "it is the counter"} if counter is not None else {}
        if checksum is not None:
            reasons[checksum.name] = "it is the checksum"
        return {name: f"{reason}, which this driver sets" for name, reason in reasons.items()}

    def protected(self, data: bytes) -> bytes:
        """A frame to be sent, with the next counter and its checksum."""
        if self._draft.counter is not None:
            data = _with_value(data, self._draft.counter, self._next)
        counter, self._next = self._next, (self._next + 1) % max(1, self._draft.values)
        if self._draft.checksum is not None:
            data = _with_value(data, self._draft.checksum, self._checksum(data, counter))
        return data

    def problem(self, data: bytes) -> str:
        """The reason why a received frame is not used: a wrong checksum, or a repeated counter; '' if used.

        Lost frames are no problem: a received value ages until the next one.
        """
        counter, checksum = self._draft.counter, self._draft.checksum
        if len(data) < self._message.length:
            return f"{len(data)} of {self._message.length} bytes: its counter and checksum cannot be checked"
        count = int(counter.extract(data)) if counter is not None else 0
        if checksum is not None:
            expected, received = self._checksum(data, count), int(checksum.extract(data))
            if expected != received:
                return f"checksum {checksum.name} is 0x{received:X}, not 0x{expected:X}"
        if counter is None:
            return ""
        if count >= self._draft.values:
            return f"counter {counter.name} is {count}, beyond {self._draft.values - 1}"
        last, self._last = self._last, count
        return f"counter {counter.name} is not incremented" if count == last else ""

    def _checksum(self, data: bytes, counter: int) -> int:
        draft = self._draft
        assert draft.checksum is not None
        data = _with_value(data, draft.checksum, 0)[: self._message.length]
        first, end = draft.checksum.first // 8, (draft.checksum.end + 7) // 8
        message = self._message
        covered = Covered(
            message.frame_id,
            message.is_extended_frame,
            data,
            data[:first] + data[end:],
            draft.ids,
            counter,
        )
        return KINDS[draft.kind].value(covered)


def protections(file: DbcFile, counters: Iterable[str], checksums: Iterable[str]) -> dict[str, Protection]:
    """The protections of a binding, by message. Raises DbcError."""
    drafts: dict[str, _Draft] = {}
    for text in counters:
        match = _COUNTER.fullmatch(text)
        if match is None:
            raise DbcError(f"'{text}' does not have the form Message.Counter or Message.Counter=VALUES")
        draft = drafts.setdefault(match[1], _Draft())
        draft.counter = _integer(file, match[1], match[2], "counter")
        maximum = 1 << draft.counter.length
        draft.values = int(match[3] or maximum)
        if not 2 <= draft.values <= maximum:
            raise DbcError(f"the counter {match[1]}.{match[2]} has 2 to {maximum} values, not {draft.values}")
    for text in checksums:
        match = _CHECKSUM.fullmatch(text)
        if match is None or match[3] not in KINDS:
            kinds = ", ".join(KINDS)
            raise DbcError(
                f"'{text}' does not have the form Message.Signal=KIND [DATA IDS]; kinds are {kinds}"
            )
        ids = tuple(int(number, 0) for number in match[4].replace(",", " ").split())
        draft = drafts.setdefault(match[1], _Draft())
        draft.checksum, draft.kind, draft.ids = _integer(file, match[1], match[2], "checksum"), match[3], ids
        _check_kind(f"{match[1]}.{match[2]}", draft)
    return {name: Protection(file.message(name), draft) for name, draft in drafts.items()}


def _check_kind(name: str, draft: _Draft) -> None:
    kind = KINDS[draft.kind]
    assert draft.checksum is not None
    if draft.checksum.length != kind.bits:
        raise DbcError(f"{name} has {draft.checksum.length} bits; the checksum {draft.kind} has {kind.bits}")
    if len(draft.ids) != kind.ids:
        raise DbcError(
            f"{name}: the checksum {draft.kind} requires {kind.ids} data ids, not {len(draft.ids)}"
        )
    if invalid := [number for number in draft.ids if number > kind.highest]:
        raise DbcError(
            f"{name}: a data id of {draft.kind} is at most 0x{kind.highest:X}, not 0x{invalid[0]:X}"
        )
    if kind.ids == 16 and draft.counter is None:
        raise DbcError(f"{name}: {draft.kind} selects its data id by the counter; add it to 'counters'")


def _integer(file: DbcFile, message: str, name: str, role: str) -> Signal:
    """An unsigned signal outside of pages. Raises DbcError."""
    signal = file.signal(message, name)
    if signal.is_float or signal.is_signed or signal.multiplexer_ids:
        raise DbcError(f"{message}.{name} cannot be a {role}: it is signed, a float, or multiplexed")
    return signal


def _with_value(data: bytes, signal: Signal, raw: int) -> bytes:
    """A frame with another value of a signal."""
    bits, mask = signal.insert(raw, len(data))
    return (int.from_bytes(data, "little") & ~mask | bits).to_bytes(len(data), "little")

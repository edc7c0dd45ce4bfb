"""Summaries of the effects of a turn in a recording, sufficient to compare two runs and to show a difference.

An effect is a list: the name of its class, then its fields. A block is replaced by its CRC-32, and so are
journal records, which contain blocks. Hybrid timestamps are left out: they order events and affect no
decision.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any
from zlib import crc32

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from lfield.errors import RecordingError
from lfield.host import effects as host_effects
from lfield.replication.transfer.effects import Send, SendTransfer
from lfield.wire.messages import RelayedMessage

_encode = msgspec.msgpack.Encoder().encode
_decode = msgspec.msgpack.Decoder(list[list[Any]]).decode


class _TransferSummary(Struct, frozen=True, array_like=True, tag="SendTransfer"):
    """A hop in a summary. A struct, since there is one in each turn of a hop: a list takes twice the time."""

    host: str
    agent: str
    generation: int
    sequence: int
    hops: int
    memory: int
    size: int
    digest: int


def _transfer(effect: SendTransfer) -> _TransferSummary:
    header = effect.header
    return _TransferSummary(
        effect.host, header.agent, header.generation, header.sequence, header.hops, header.receiver_memory,
        header.size, crc32(effect.block),
    )  # fmt: skip


def _unstamped(message: Any) -> object:
    """A message without its hybrid timestamp, which depends on who observes the host."""
    if isinstance(message, RelayedMessage):
        return [message.origin, message.receiver, _unstamped(message.message)]
    return replace(message, stamp=0) if hasattr(message, "stamp") else message


def _device_call(effect: host_effects.CallDevice) -> list[object]:
    call = effect.call
    command = [call.field, call.instruction, effect.values]
    return [effect.agent.id, effect.thread, *command, effect.until, effect.number]


_FIELDS: dict[type[Any], Callable[[Any], list[object]]] = {
    Send: lambda each: [each.host, type(each.message).__name__, _unstamped(each.message)],
    host_effects.WriteOutput: lambda each: [each.agent, each.text],
    host_effects.WriteLog: lambda each: [str(each.text)],
    host_effects.WriteLogOnce: lambda each: [str(each.text)],
    host_effects.CallDevice: _device_call,
    host_effects.CancelCall: lambda each: [each.agent.id, each.thread],
    host_effects.MakeDeviceSafe: lambda each: [each.device, each.state, each.reason, each.users],
    host_effects.DumpAgent: lambda each: [each.agent.id],
    host_effects.PersistRecords: lambda each: [each.number, crc32(_encode([each.records, each.keys]))],
    host_effects.OpenLink: lambda each: [each.host],
    host_effects.WakeWaiters: lambda each: [],
    host_effects.AnswerPersonCall: lambda each: [each.result],
}


def encode_effects(effects: Sequence[host_effects.Effect]) -> bytes:
    """The summary of the effects of a turn; b"" for none."""
    if not effects:
        return b""
    if len(effects) == 1 and type(effect := effects[0]) is SendTransfer:
        return _encode([_transfer(effect)])
    return _encode([_transfer(each) if type(each) is SendTransfer else _other(each) for each in effects])


def _other(effect: host_effects.Effect) -> list[object]:
    return [type(effect).__name__, *_FIELDS[type(effect)](effect)]


def decode_effects(data: bytes) -> list[list[Any]]:
    """The effects in a summary, as plain data. Raises RecordingError."""
    if not data:
        return []
    try:
        found = _decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RecordingError(f"the effects of a turn are damaged: {error}") from None
    if not all(map(_is_valid, found)):
        raise RecordingError("the effects of a turn are damaged")
    return found


def _is_valid(effect: list[Any]) -> bool:
    """Whether an effect has the fields that are used for more than comparison."""
    match effect:
        case ["SendTransfer", *fields]:
            return [type(each) for each in fields[:4]] == [str, str, int, int]
        case ["CallDevice", str(), *_, int()]:
            return True
        case ["CallDevice", *_]:
            return False
        case [str(), *_]:
            return True
    return False

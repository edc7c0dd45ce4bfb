"""The records of a journal, one for each stored object, overwritten by key; and their encoding.

A record is a msgpack array whose first item is its tag. `lfield/docs/formats.md` lists all kinds.
"""

from __future__ import annotations

import struct
import zlib
from typing import Literal, NamedTuple

import msgspec
from msgspec import Struct

from lfield.wire.coordinator_messages import Outcome
from lfield.wire.fields import Count, Hash

#: The version of all records written here. A record of a newer version is not read.
VERSION = 2

#: States of a stored copy. FROZEN is not stored: the copy was not sent, so it counts as the copy that last
#: ran here.
StoredState = Literal["ABSENT", "RUN", "PREPARED", "MOVED", "EXITED"]

_CHECKED = struct.Struct("<qdH")


class RecordKey(NamedTuple):
    """The key of a record: its kind, and its agent or digest (in hex) and number, if any."""

    kind: str
    name: str = ""
    number: int = 0


class CoordinatorRecord(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="copy"):
    """One start of one coordinator, as known to this host (replication/transfer/coordinator_copies.py).

    `sequence` is the highest transfer number that this start used or tried here. `kind` and `reason` are the
    refusal of that transfer, '' for none. `target` is the destination of the transfer, and `receiver_memory`
    the id of that host's journal, or of its process if it has none. `outcome`, `detail` and `ended_on` belong
    to EXITED. `program` is the hash of the program and deployment of the block, b"" without a block; `block`
    its bytes, b"" for none. `doubt` is the reason why the state of a sent copy is unknown, '' if it is known.
    """

    agent: str
    generation: Count
    state: StoredState
    sequence: Count = 0
    hops: Count = 0
    kind: str = ""
    reason: str = ""
    target: str = ""
    receiver_memory: Count = 0
    outcome: Outcome | Literal[""] = ""
    detail: str = ""
    ended_on: str = ""
    program: Hash = b""
    block: bytes = b""
    doubt: str = ""


class PendingCallRecord(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="begun"):
    """A portal call that a coordinator has started here and fetches later (`together`;
    host/team/pending_call_store.py).

    `number` identifies the call within one start; `resource` and `portal` are names. `outcome` is '' while
    the call may be under way; `result` is the packed result or exception of the mission with the hash
    `program`.
    """

    agent: str
    generation: Count
    number: Count
    resource: str
    portal: str
    outcome: Literal["", "done", "thrown"] = ""
    result: bytes = b""
    program: Hash = b""


class ReservationRecord(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="reservation"):
    """The number of the last reservation of a resource here, and the start of the agent that holds it.

    `agent` is '' when the resource is free.
    """

    resource: str
    number: Count
    agent: str = ""
    generation: Count = 0


class SequenceRecord(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="sequence"):
    """The last start of a startable coordinator by this host, its home, for a `request` of another
    coordinator.

    `stopping` is the coordinator that has ordered its end, '' for none.
    """

    agent: str
    generation: Count = 0
    request: Count = 0
    stopping: str = ""


class StartCounter(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="starts"):
    """The number of starts on this host: the counter from which generations are derived."""

    count: Count


class RunMarker(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="run"):
    """Whether the next start of this host continues the run; an orderly end without copies clears it."""

    open: bool


class BundleRecord(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="bundle"):
    """The digest of the signed bundle that this host has started; b"" once the bundle and every coordinator
    of the team have ended, as far as this host knows."""

    digest: Hash


class PauseFlag(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="paused"):
    """Whether the mission is paused on this host: no agent runs until it is resumed.

    `order` is the id of the last pause or resume order, b"" in records of version 1.
    """

    on: bool
    order: bytes = b""


class EmergencyStopFlag(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="stopped"):
    """The reason why an emergency stop locks the devices of this host, '' after it was lifted.

    `order` is the id of the last stop or lift order, b"" for a lock-out and in records of version 1.
    """

    reason: str
    order: bytes = b""


class FenceRecord(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="fence"):
    """A fencing token: no copy of an earlier generation of this agent may run here."""

    agent: str
    generation: Count


class ProgramRecord(Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag="program"):
    """The program of blocks, stored once for each digest in other records.

    `code` is a program file (bytecode/encoding.py). `members`, `types` and `hosts` are the ids and types of
    the team's agents and its hosts, in order: proxies and trails are indexes into them.
    """

    digest: Hash
    code: bytes
    members: tuple[str, ...] = ()
    types: tuple[str, ...] = ()
    hosts: tuple[str, ...] = ()


Record = (
    CoordinatorRecord
    | PendingCallRecord
    | ReservationRecord
    | SequenceRecord
    | StartCounter
    | RunMarker
    | BundleRecord
    | PauseFlag
    | EmergencyStopFlag
    | FenceRecord
    | ProgramRecord
)

_encode = msgspec.msgpack.Encoder().encode
_decoder: msgspec.msgpack.Decoder[Record] = msgspec.msgpack.Decoder(Record)


class RecordError(Exception):
    """Bytes that do not match their key and checksum. Internal to this package."""


def key_of(record: Record) -> RecordKey:
    """The key of a record."""
    match record:
        case CoordinatorRecord():
            return RecordKey("copy", record.agent, record.generation)
        case PendingCallRecord():
            return pending_call_key(record.agent, record.generation, record.number)
        case ReservationRecord():
            return RecordKey("reservation", record.resource)
        case SequenceRecord():
            return RecordKey("sequence", record.agent)
        case FenceRecord():
            return RecordKey("fence", record.agent)
        case ProgramRecord():
            return RecordKey("program", record.digest.hex())
        case StartCounter():
            return RecordKey("starts")
        case RunMarker():
            return RecordKey("run")
        case BundleRecord():
            return RecordKey("bundle")
        case PauseFlag():
            return RecordKey("paused")
        case EmergencyStopFlag():
            return RecordKey("stopped")


def pending_call_key(agent: str, generation: int, number: int) -> RecordKey:
    """The key of a pending call."""
    return RecordKey("begun", f"{generation} {agent}", number)


class UnsupportedRecordVersion(RecordError):
    """A valid record of a later version of lfield."""


class JournalEntry(NamedTuple):
    """A record as stored: `written_at` in Unix time, seconds; `checksum` covers the other fields."""

    key: RecordKey
    written_at: float
    version: int
    body: bytes
    checksum: int


def encode_record(record: Record, written_at: float) -> JournalEntry:
    """Encode a record for the disk."""
    key, body = key_of(record), _encode(record)
    return JournalEntry(key, written_at, VERSION, body, _check(key, written_at, VERSION, body))


def decode_record(entry: JournalEntry) -> Record:
    """The record of an entry. Raises RecordError."""
    try:
        if entry.checksum != _check(*entry[:-1]):
            raise RecordError("its checksum does not fit")
        if entry.version > VERSION:
            raise UnsupportedRecordVersion(f"it is of version {entry.version}")
        record = _decoder.decode(entry.body)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise RecordError(f"it cannot be read: {error}") from None
    except (TypeError, ValueError, AttributeError, struct.error):
        raise RecordError("it is not of the right kind") from None
    if key_of(record) != entry.key:
        raise RecordError("it is stored under another key")
    return record


def _check(key: RecordKey, written_at: float, version: int, body: bytes) -> int:
    """The CRC-32 of the whole entry, key included."""
    start = zlib.crc32(f"{key.kind}\0{key.name}\0".encode())
    return zlib.crc32(body, zlib.crc32(_CHECKED.pack(key.number, written_at, version), start))

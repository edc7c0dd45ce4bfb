"""The records of a host's recording, and their encoding in frames.

A frame (`lfield.recording.segments`) has the records of a short time: a header, then a msgpack list,
compressed by zlib. The first frame of an incarnation has a `StartRecord` only; the first one of every later
segment has a `CheckpointRecord` only.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from struct import Struct as Layout
from typing import Annotated, Any, NamedTuple

import msgspec
from msgspec import Meta, Struct

from lfield.errors import RecordingError
from lfield.host.inputs import RecordedInput
from lfield.journal.records import Record, RecordKey
from lfield.manifest import DeviceValue
from lfield.vm.turns.run_limit import UNCUT, RunCuts
from lfield.wire.events import StateEvent

#: The largest decompressed frame, in bytes.
MAX_FRAME = 1 << 28
_TOO_LARGE = f"a frame has more than {MAX_FRAME >> 20} MB"
#: Hybrid clock of a host, see `HybridClock.state`.
ClockState = tuple[int, float, float, float]


class HostRecord(Struct, frozen=True, array_like=True):
    """Base class of the records."""


class Release(Struct, frozen=True, array_like=True):
    """The bundle that the mission was read from, see `BundleId`."""

    digest: bytes
    signature: bytes
    by: str
    at: float
    is_from_files: bool


class StartRecord(HostRecord, frozen=True, tag=1):
    """The start of an incarnation: all data that the core is constructed from.

    `bundle` is the digest of the bundle in the folder, which is the bundle of the mission that runs;
    `release` is the bundle that the mission was read from. `seed` is the seed of the core's random numbers.
    `records` are the contents of the journal, `times` the Unix times at which they were written. `pace` is
    the pace of the engine; `metered`: a simulation meters its instructions. `at` and `wall` are the time of
    the construction, `drawn` the random bytes that were drawn during the construction.
    """

    lfield: str
    host: str
    incarnation: int
    run: str
    mission: str
    bundle: bytes
    release: Release
    seed: int
    unreachable_after: float
    journal_id: int
    records: list[Record]
    times: list[tuple[RecordKey, float]]
    engine: str
    pace: int
    metered: bool
    at: float
    wall: float
    clock: ClockState
    drawn: list[bytes]


class IdleTurn(HostRecord, frozen=True, tag=2):
    """A turn without input, new answers, effects and digests, at that time of the monotonic clock."""

    at: float


class RecordedAnswer(Struct, frozen=True, array_like=True):
    """The new answer of the environment to a question, with the arguments of the question.

    `error` has device, reason and kind of a DeviceError.
    """

    question: int
    arguments: list[str | int]
    value: Any
    error: tuple[str, ...] = ()


class ReadingChange(Struct, frozen=True, array_like=True):
    """A reading, by number, has changed since the last turn; `raw` is its word."""

    number: int
    raw: int
    until: float


class BlockDigest(Struct, frozen=True, array_like=True):
    """The CRC-32 of the used words of an agent's block, and their number."""

    agent: str
    digest: int
    size: int


class TurnRecord(HostRecord, frozen=True, tag=3):
    """One turn: its time and input; the changes outside the core; the effects of the core.

    `wall` is the wall-clock time if it was read. `clock` is the state of the hybrid clock if events between
    two turns have changed it. `effects` is the msgpack of the effects (`effect_summary`). `run` is false if
    an input was passed between two turns, without running the core. `times` are the real times that were read
    within the turn.
    """

    at: float
    entry: RecordedInput | None = None
    wall: float | None = None
    clock: ClockState | None = None
    answers: list[RecordedAnswer] = []
    readings: list[ReadingChange] = []
    drawn: list[bytes] = []
    cuts: RunCuts = UNCUT
    effects: bytes = b""
    digests: list[BlockDigest] = []
    run: bool = True
    times: list[float] = []


class CheckpointRecord(HostRecord, frozen=True, tag=4):
    """The whole state of the core after the record before: a replay can begin here.

    `start` is the record of the incarnation, `snapshot` is made by `core_snapshot`; `answers` and `readings`
    are the answers and readings of the environment, as far as the core knows them. `runs` are the run ids
    that the host has had, the present one last: the records before may be deleted.
    """

    at: float
    start: StartRecord
    snapshot: bytes
    answers: list[RecordedAnswer]
    readings: list[ReadingChange]
    runs: list[str] = []


class RunIdRecord(HostRecord, frozen=True, tag=5):
    """The run id of this host has changed: the host has met an older run."""

    run: str


class EndRecord(HostRecord, frozen=True, tag=6):
    """The host has ended in order: no record is missing."""

    at: float


class ShellEventRecord(HostRecord, frozen=True, tag=7):
    """An event that the core did not make: an order of an operator, or a log line of the shell."""

    at: float
    what: StateEvent


AnyRecord = (
    StartRecord | IdleTurn | TurnRecord | CheckpointRecord | RunIdRecord | EndRecord | ShellEventRecord
)
#: A list of records of bounded length.
_Batch = Annotated[list[AnyRecord], Meta(max_length=1 << 20)]
_HEADER = Layout("<cdI")
#: The beginning of a list in msgpack, with the number of its elements.
_ARRAY, _ARRAY_CODE = Layout(">BI"), 0xDD
_encoder = msgspec.msgpack.Encoder()
_decoder: msgspec.msgpack.Decoder[list[AnyRecord]] = msgspec.msgpack.Decoder(_Batch)


class FrameHeader(NamedTuple):
    """The kind of a frame (b"S" has a start, b"C" a checkpoint, b"T" turns), its time, and its turns."""

    kind: bytes
    at: float
    turns: int


class FrameBuffer:
    """Collects the records of a frame. Each record is encoded at once: its data may change later, and its
    objects are free for the next turn.
    """

    def __init__(self) -> None:
        self._data = bytearray(_ARRAY.size)
        #: The number of records, and the number of turns among them.
        self.records = self.turns = 0

    def add(self, record: HostRecord) -> None:
        """Add a record that is no turn."""
        self.records += 1
        _encoder.encode_into(record, self._data, -1)

    def add_turn(self, record: IdleTurn | TurnRecord) -> int:
        """Add a turn; returns the bytes of all records."""
        self.turns += 1
        self.records += 1
        data = self._data
        _encoder.encode_into(record, data, -1)
        return len(data)

    def content(self, kind: bytes, at: float) -> bytes:
        """The content of a frame; the buffer is empty after the call. Raises RecordingError if a reader would
        refuse it.
        """
        data, header = self._data, FrameHeader(kind, at, self.turns)
        _ARRAY.pack_into(data, 0, _ARRAY_CODE, self.records)
        self._data, self.records, self.turns = bytearray(_ARRAY.size), 0, 0
        if len(data) > MAX_FRAME:
            raise RecordingError(_TOO_LARGE)
        return _HEADER.pack(*header) + zlib.compress(data, 1)


def encode_frame(records: Iterable[HostRecord], header: FrameHeader) -> bytes:
    """Records as the content of a frame. Raises RecordingError if a reader would refuse it."""
    buffer = FrameBuffer()
    for record in records:
        buffer.add(record)
    return _HEADER.pack(*header) + buffer.content(header.kind, header.at)[_HEADER.size :]


def header_of(data: bytes) -> FrameHeader:
    """The header of a frame. Raises RecordingError."""
    if len(data) < _HEADER.size:
        raise RecordingError("a frame is too short")
    return FrameHeader(*_HEADER.unpack_from(data))


def decode_frame(data: bytes) -> list[AnyRecord]:
    """The records of a frame. Raises RecordingError."""
    try:
        unpacker = zlib.decompressobj()
        plain = unpacker.decompress(data[_HEADER.size :], MAX_FRAME)
        if unpacker.unconsumed_tail:
            raise RecordingError(_TOO_LARGE)
        return _decoder.decode(plain)
    except (zlib.error, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise RecordingError(f"a record is damaged: {error}") from None


def value_of(answer: RecordedAnswer) -> DeviceValue:
    """The value of an answer of a device."""
    value: DeviceValue = answer.value
    return value

"""The recording of one incarnation of a host: its frames in order, decoded as they are needed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from operator import attrgetter
from typing import NamedTuple

from lfield.errors import RecordingError
from lfield.host.recording.effect_summary import decode_effects
from lfield.host.recording.host_records import (
    AnyRecord,
    CheckpointRecord,
    EndRecord,
    FrameHeader,
    IdleTurn,
    RunIdRecord,
    ShellEventRecord,
    StartRecord,
    TurnRecord,
    decode_frame,
    header_of,
)
from lfield.wire.events import StateEvent

Turn = IdleTurn | TurnRecord
#: Decoded frames that are kept.
_CACHED = 64


class IndexedFrame(NamedTuple):
    """A frame, and the number of turns before it in this recording."""

    header: FrameHeader
    data: bytes
    turn: int


class OutsideEvent(NamedTuple):
    """An event that the core did not make, and its time on the monotonic clock of the host."""

    at: float
    what: StateEvent


class HostRecording:
    """One incarnation; `gap` describes the data missing at its end, '' if the host ended in order.

    `frames` are contents of frames, oldest first; `gap` is the reason of an early end of reading. The first
    frames may be missing (a ring deletes its oldest file): then the recording begins at a checkpoint. Raises
    RecordingError if no turn can be replayed.
    """

    def __init__(self, frames: Sequence[bytes], gap: str = "") -> None:
        self.frames: list[IndexedFrame] = []
        turn = 0
        for data in frames:
            header = header_of(data)
            if not self.frames and header.kind == b"T":
                continue
            self.frames.append(IndexedFrame(header, data, turn))
            turn += header.turns
        if not self.frames:
            raise RecordingError("it has neither the beginning of a recording nor a checkpoint")
        #: The number of turns in the recording.
        self.turns = turn
        self._decode = lru_cache(_CACHED)(self._decode_frame)
        first = self._decode(0)
        self.start: StartRecord = self._start_of(first[0]) if first else self._raise_empty()
        #: Whether the recording has the start of the incarnation.
        self.is_from_start = isinstance(first[0], StartRecord)
        last = self._decode(len(self.frames) - 1)
        #: The events that a replay of the core does not make.
        self.outside_events = [
            OutsideEvent(record.at, record.what)
            for number in range(len(self.frames))
            for record in self._decode(number)
            if isinstance(record, ShellEventRecord)
        ]
        self.gap = "" if last and isinstance(last[-1], EndRecord) else gap or "its end is missing"

    @property
    def host(self) -> str:
        """The name of the host."""
        return self.start.host

    def add_outside_events(self, found: Iterable[OutsideEvent]) -> None:
        """Add events of the host from another recording, as that of a guard."""
        self.outside_events = sorted([*self.outside_events, *found], key=attrgetter("at"))

    @property
    def runs(self) -> list[str]:
        """The run ids that the host has had, the last one last."""
        found = dict.fromkeys([self.start.run])
        for number in range(len(self.frames)):
            for record in self._decode(number):
                match record:
                    case CheckpointRecord(runs=known):
                        found.update(dict.fromkeys(known))
                    case RunIdRecord(run=run):
                        found[run] = None
        return list(found)

    @property
    def started_at(self) -> float:
        """The time of the first turn, on the monotonic clock of the host."""
        return self.frames[0].header.at

    @property
    def ended_at(self) -> float:
        """The time of the last turn."""
        for number in reversed(range(len(self.frames))):
            times = [record.at for record in self._decode(number) if isinstance(record, Turn)]
            if times:
                return times[-1]
        return self.started_at

    def turns_from(self, turn: int) -> Iterator[tuple[int, Turn]]:
        """The turns from a number on, with their numbers. Raises RecordingError."""
        for number in range(self._frame_of(turn), len(self.frames)):
            at = self.frames[number].turn
            for record in self._decode(number):
                if isinstance(record, Turn):
                    if at >= turn:
                        yield at, record
                    at += 1

    def checkpoint_before(self, turn: int) -> tuple[int, CheckpointRecord | None]:
        """The last checkpoint at which a replay up to a turn can begin, with the number of the turn after it;
        None for the start of the recording."""
        for number in reversed(range(len(self.frames))):
            frame = self.frames[number]
            if frame.turn <= turn and frame.header.kind == b"C":
                records = self._decode(number)
                if not records or not isinstance(records[0], CheckpointRecord):
                    raise RecordingError("a checkpoint is damaged")
                return frame.turn, records[0]
        if not self.is_from_start:
            raise RecordingError("the beginning of the recording is missing")
        return 0, None

    def _frame_of(self, turn: int) -> int:
        """The first frame that may have that turn."""
        found = 0
        for number, frame in enumerate(self.frames):
            if frame.turn > turn:
                break
            found = number if frame.header.turns else found
        return found

    def _decode_frame(self, number: int) -> list[AnyRecord]:
        return decode_frame(self.frames[number].data)

    def _start_of(self, record: AnyRecord) -> StartRecord:
        match record:
            case StartRecord():
                return record
            case CheckpointRecord():
                return record.start
        return self._raise_empty()

    def _raise_empty(self) -> StartRecord:
        raise RecordingError("its first record is neither the start of a host nor a checkpoint")


def require_valid(data: bytes) -> None:
    """Raise RecordingError if the content of a frame cannot be used: no part of it is decoded later."""
    header = header_of(data)
    records = decode_frame(data)
    turns = [record for record in records if isinstance(record, Turn)]
    if len(turns) != header.turns:
        raise RecordingError("its header counts other turns than it has")
    for record in turns:
        if isinstance(record, TurnRecord):
            decode_effects(record.effects)

"""Records the core of one host: an entry for each turn, digests of blocks, and checkpoints.

A turn is recorded after its effects are executed: the messages of the turn do not wait for the recorder.
Between two turns the recorder compresses the records of a short time together; a thread writes them to disk
(`RingWriter`). The recorder never causes a failure of the host: if the disk or the recorder itself fails,
recording ends with a log line.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol
from zlib import crc32

from msgspec.structs import replace

from lfield.host.core import HostCore
from lfield.host.effects import Effect, WriteLog
from lfield.host.inputs import HostInput
from lfield.host.recording.core_snapshot import CoreSnapshots
from lfield.host.recording.effect_summary import encode_effects
from lfield.host.recording.host_records import (
    BlockDigest,
    CheckpointRecord,
    ClockState,
    EndRecord,
    FrameBuffer,
    FrameHeader,
    HostRecord,
    IdleTurn,
    ReadingChange,
    RunIdRecord,
    ShellEventRecord,
    StartRecord,
    TurnRecord,
    encode_frame,
)
from lfield.host.recording.recorded_environment import RecordedEnvironment
from lfield.host.recording.recording_target import RecordSink
from lfield.recording.segments import frame
from lfield.vm.memory.block import Block
from lfield.vm.turns.run_limit import UNCUT, RunLimit
from lfield.wire.events import LineLogged, StateEvent
from lfield.wire.fields import truncate

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

#: Seconds between two digests of the blocks, and the bytes of blocks that lengthen it by one second.
DIGEST_INTERVAL, BYTES_PER_SECOND = 0.1, 5e6
#: Seconds between two checkpoints, and the bytes of records after which a checkpoint is made earlier.
CHECKPOINT_INTERVAL, CHECKPOINT_BYTES = 60.0, 1 << 20
#: Seconds for which records are collected, and the bytes after which they are written earlier: a file ends
#: between two batches.
BATCH_INTERVAL, BATCH_BYTES = 0.25, 1 << 16

#: An empty list that is never changed.
_NOTHING: list[Any] = []
_EndedTurn = tuple[float, HostInput | None, "Sequence[Effect]", bool, float | None]


class TurnTime(Protocol):
    """The clock of the core's turns."""

    @property
    def wall_time(self) -> float | None:
        """The wall-clock time of the present turn, None if it was not read."""

    def now(self) -> float:
        """The time of the present turn, or between two turns the real time; monotonic, in seconds."""


class FlightRecorder:
    """Records `core` into `sink`; `start` describes the incarnation.

    `on_pending` is called for the first record that waits for `write_due` or `flush`.
    """

    def __init__(
        self,
        core: HostCore,
        clock: TurnTime,
        environment: RecordedEnvironment,
        start: StartRecord,
        sink: RecordSink,
        drawn: list[bytes],
        on_pending: Callable[[], None],
    ) -> None:
        self._core, self._clock, self._environment, self._sink = core, clock, environment, sink
        self._start, self._drawn, self._on_pending = start, drawn, on_pending
        environment.start()
        self._run_ids = [start.run]
        #: The lines that the last turn has written.
        self._written: list[str] = []
        self._hybrid, self._limit = core.recorder.hybrid_clock, core.context.run_limit or RunLimit(float)
        self._snapshots = CoreSnapshots(core, environment.number_of)
        self._buffer = FrameBuffer()
        #: The bytes since the last checkpoint.
        self._bytes = 0
        #: The time of the first turn in the buffer.
        self._first_at = start.at
        #: An exception of the recorder, which ends the recording when it is written next.
        self._fault: Exception | None = None
        #: The real times that the core has read within the turn.
        self.times: list[float] = []
        #: The turn that has ended and is not recorded yet: time, input, effects, whether the core was run,
        #: and the wall-clock time.
        self._ended: _EndedTurn | None = None
        #: Whether `write_due` has work to do.
        self._is_due = False
        self._is_started = self._is_closed = False
        self._batch_due = self._digest_due = 0.0
        self._checkpoint_due = start.at + CHECKPOINT_INTERVAL
        #: The hybrid clock at the end of the last turn, and the changes before the present turn.
        self._stamp, self._clock_settings = self._hybrid.last, self._hybrid.settings
        self._clock_change: ClockState | None = None
        self._readings: list[ReadingChange] = []

    # --- turns ----------------------------------------------------------------------------------------

    def start_turn(self) -> None:
        """A turn begins."""
        if self._ended is not None:
            self.complete_turn()
        environment, clock = self._environment, self._hybrid
        self._readings = environment.drain_changed_readings() if environment.has_readings else _NOTHING
        is_same = clock.last == self._stamp and clock.settings == self._clock_settings
        self._clock_change = None if is_same else clock.state

    def end_turn(
        self, at: float, entry: HostInput | None, effects: Sequence[Effect], *, runs: bool = True
    ) -> None:
        """The turn of that time with that input has ended; without `runs` the core was not run.

        Its effects are executed next, and it is recorded after that: a hop does not wait for the recorder.
        """
        clock = self._hybrid
        self._stamp, self._clock_settings = clock.last, clock.settings
        self._ended = at, entry, effects, runs, self._clock.wall_time

    def complete_turn(self) -> bool:
        """Record the turn that has ended, if any; returns whether `write_due` must follow."""
        if (ended := self._ended) is None:
            return self._is_due
        self._ended, buffer, at = None, self._buffer, ended[0]
        if not buffer.turns:
            self._first_at = at
        if not buffer.records:
            self._on_pending()
        try:
            size = buffer.add_turn(self._record(*ended))
        except Exception as error:  # of the recorder, which must not end the host
            self._fault, size = error, BATCH_BYTES
        if at >= self._batch_due or size >= BATCH_BYTES:
            self._is_due = True
        return self._is_due

    def _record(
        self,
        at: float,
        entry: HostInput | None,
        effects: Sequence[Effect],
        runs: bool,
        wall: float | None,
    ) -> IdleTurn | TurnRecord:
        clock, readings, limit = self._clock_change, self._readings, self._limit
        answers = self._environment.drain_answers()
        cuts = limit.drain_cuts() if limit.has_cuts else UNCUT
        summary = encode_effects(effects) if effects else b""
        if self._written:
            self._written = []
        for each in effects:
            if type(each) is WriteLog:
                self._written.append(truncate(str(each.text)))
        digests = self._digests(at) if at >= self._digest_due else _NOTHING
        drawn, times = _NOTHING, _NOTHING
        if self._drawn:
            drawn = self._drawn.copy()
            self._drawn.clear()
        if self.times:
            times, self.times = self.times, []
        is_idle = entry is None and not (answers or readings or drawn or summary or digests or times)
        if is_idle and runs and cuts is UNCUT and wall is None and clock is None:
            return IdleTurn(at)
        changes = wall, clock, answers, readings, drawn, cuts, summary, digests, runs, times
        return TurnRecord(at, entry, *changes)  # type: ignore[arg-type]  # a tuple of several types

    def note_event(self, event: StateEvent) -> None:
        """The shell has made an event; a replay itself makes the log lines that are effects."""
        self.complete_turn()
        if isinstance(event, LineLogged) and event.text in self._written:
            self._written.remove(event.text)
            return
        self._add(ShellEventRecord(self._clock.now(), event))

    def _add(self, record: HostRecord) -> None:
        if not self._buffer.records:
            self._on_pending()
        try:
            self._buffer.add(record)
        except Exception as error:
            self._fault, self._is_due = error, True

    def _digests(self, at: float) -> list[BlockDigest]:
        agents = self._core.machine.agents
        found = [block_digest(name, agents[name].block) for name in sorted(agents)]
        size = 8 * sum(each.size for each in found)
        self._digest_due = at + max(DIGEST_INTERVAL, size / BYTES_PER_SECOND)
        return found

    # --- files ----------------------------------------------------------------------------------------

    def write_due(self, now: float) -> None:
        """Between two turns, write the data that is due."""
        self._is_due, self._batch_due = False, now + BATCH_INTERVAL
        self._write_batch()
        if now >= self._checkpoint_due or self._bytes >= CHECKPOINT_BYTES or self._sink.is_full:
            self._write_checkpoint(now)

    def flush(self) -> None:
        """Write the pending data."""
        self._write_batch()

    def note_run(self, run: str) -> None:
        """The run id of this host has changed."""
        self._run_ids.append(run)
        self._add(RunIdRecord(run))

    def close(self, at: float) -> None:
        """The host ends in order."""
        if self._is_closed:
            return
        self.complete_turn()
        self._is_closed = True
        self._buffer.add(EndRecord(at))
        self._write_batch()
        self._sink.close()

    def _write_batch(self) -> None:
        self.complete_turn()
        if self._fault is not None:
            raise self._fault
        if not self._buffer.records:
            return
        if not self._is_started:
            self._is_started = True
            metered = self._core.machine.hooks.meter is not None
            started = replace(self._start, metered=metered)
            self._sink.start_file(_frame(started, b"S", started.at))
        data = frame(self._buffer.content(b"T", self._first_at))
        self._bytes += len(data)
        self._sink.append(data)

    def _write_checkpoint(self, now: float) -> None:
        environment = self._environment
        record = CheckpointRecord(
            now,
            replace(
                self._start, metered=self._core.machine.hooks.meter is not None, clock=self._hybrid.state
            ),
            self._snapshots.capture(),
            environment.answers,
            environment.readings,
            self._run_ids.copy(),
        )
        self._bytes, self._checkpoint_due = 0, now + CHECKPOINT_INTERVAL
        data = _frame(record, b"C", now)
        if self._sink.is_full:
            self._sink.start_file(data)
        else:
            self._sink.append(data)


def block_digest(agent: str, block: Block) -> BlockDigest:
    """The digest of the used words of a block."""
    top = block.top
    return BlockDigest(agent, crc32(memoryview(block.data)[: 8 * top]), top)


def _frame(record: HostRecord, kind: bytes, at: float) -> bytes:
    return frame(encode_frame([record], FrameHeader(kind, at, 0)))

"""Records the core of one host: an entry for each turn, digests of blocks, and checkpoints.

The recorder encodes between turns and leaves the disk to a thread (`RingWriter`). It never fails the host: if
the disk or the recorder itself fails, recording ends with a log line.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol
from zlib import crc32

from msgspec.structs import replace

from lfield.host.core import HostCore
from lfield.host.effects import Effect, WriteLog
from lfield.host.inputs import HostInput, TransferArrived
from lfield.host.recording.core_snapshot import CoreSnapshots
from lfield.host.recording.effect_summary import encode_effects
from lfield.host.recording.host_records import (
    BlockDigest,
    CheckpointRecord,
    ClockState,
    EndRecord,
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
#: Seconds between two checkpoints, and the bytes of records after which one is made earlier.
CHECKPOINT_INTERVAL, CHECKPOINT_BYTES = 60.0, 1 << 20
#: Seconds for which records are collected; the turns, and the bytes of arrived blocks, after which they are
#: written earlier: a file ends between two batches.
BATCH_INTERVAL, BATCH_TURNS, BATCH_BYTES = 0.25, 256, 1 << 16

#: An empty list that is never changed.
_NOTHING: list[Any] = []
_NO_ENTRY: HostInput | None = None


class TurnTime(Protocol):
    """The clock of the core's turns."""

    @property
    def wall_time(self) -> float | None:
        """The wall-clock time of the present turn, None if it was not read."""

    def now(self) -> float:
        """The time of the present turn, or between two turns the real time; monotonic, in seconds."""


class FlightRecorder:
    """Records `core` into `sink`; `start` describes the incarnation.

    `on_pending` is called when a record waits for `write_due` or `flush` and none did before.
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
        self._run_ids = [start.run]
        #: The lines that the last turn has written.
        self._written: list[str] = []
        self._hybrid, self._limit = core.recorder.hybrid_clock, core.context.run_limit or RunLimit(float)
        self._snapshots = CoreSnapshots(core, environment.number_of)
        self._records: list[HostRecord] = []
        #: The bytes since the last checkpoint, and those of the blocks in `_records`.
        self._bytes = self._block_bytes = self._turns = 0
        #: The time of the first turn of this batch.
        self._batch_at = start.at
        self._times: list[float] = []
        self._is_started = self._is_closed = False
        self._batch_due = self._digest_due = 0.0
        self._checkpoint_due = start.at + CHECKPOINT_INTERVAL
        self._clock_state = self._hybrid.state
        #: The present turn: its time, its input, whether the core is run, and what has changed before it.
        self._at, self._entry, self._runs = 0.0, _NO_ENTRY, True
        self._clock_change: ClockState | None = None
        self._readings: list[ReadingChange] = []

    # --- turns ----------------------------------------------------------------------------------------

    def start_turn(self, at: float, entry: HostInput | None, *, runs: bool = True) -> None:
        """A turn begins at that time, with that input; without `runs` the core is not run."""
        self._at, self._entry, self._runs = at, entry, runs
        self._readings = self._environment.start_turn()
        if not self._records:
            self._batch_at = at
        state = self._hybrid.state
        self._clock_change = None if state == self._clock_state else state

    def end_turn(self, effects: Sequence[Effect]) -> None:
        """The turn has ended, with these effects; they are not executed yet."""
        at, entry, clock, readings = self._at, self._entry, self._clock_change, self._readings
        answers = self._environment.end_turn()
        self._clock_state = self._hybrid.state
        cuts = self._limit.drain_cuts()
        summary = encode_effects(effects) if effects else b""
        self._written = [
            truncate(str(each.text)) for each in effects if isinstance(each, WriteLog)
        ] or _NOTHING
        digests = self._digests(at) if at >= self._digest_due else _NOTHING
        drawn, times, wall = _NOTHING, _NOTHING, self._clock.wall_time
        if self._drawn:
            drawn = self._drawn.copy()
            self._drawn.clear()
        if self._times:
            times, self._times = self._times, []
        self._turns += 1
        if not self._records:
            self._on_pending()
        if isinstance(entry, TransferArrived):
            self._block_bytes += len(entry.block)
        is_idle = entry is None and not (answers or readings or drawn or summary or digests or times)
        if is_idle and self._runs and cuts is UNCUT and wall is None and clock is None:
            self._records.append(IdleTurn(at))
            return
        changes = wall, clock, answers, readings, drawn, cuts, summary, digests, self._runs, times
        self._records.append(TurnRecord(at, entry, *changes))  # type: ignore[arg-type]

    def note_event(self, what: StateEvent) -> None:
        """The shell has made an event; a replay makes the log lines that are effects itself."""
        if isinstance(what, LineLogged) and what.text in self._written:
            self._written.remove(what.text)
            return
        if not self._records:
            self._on_pending()
        self._records.append(ShellEventRecord(self._clock.now(), what))

    def note_time(self, at: float) -> None:
        """The core has read the real time within the turn."""
        self._times.append(at)

    def _digests(self, at: float) -> list[BlockDigest]:
        agents = self._core.machine.agents
        found = [block_digest(name, agents[name].block) for name in sorted(agents)]
        size = 8 * sum(each.size for each in found)
        self._digest_due = at + max(DIGEST_INTERVAL, size / BYTES_PER_SECOND)
        return found

    # --- files ----------------------------------------------------------------------------------------

    def write_due(self, now: float) -> None:
        """Between two turns: write what is due."""
        if now < self._batch_due and len(self._records) < BATCH_TURNS and self._block_bytes < BATCH_BYTES:
            return
        self._batch_due = now + BATCH_INTERVAL
        self._write_batch()
        if now >= self._checkpoint_due or self._bytes >= CHECKPOINT_BYTES or self._sink.is_full:
            self._write_checkpoint(now)

    def flush(self) -> None:
        """Write what is pending."""
        self._write_batch()

    def note_run(self, run: str) -> None:
        """The run id of this host has changed."""
        self._run_ids.append(run)
        if not self._records:
            self._on_pending()
        self._records.append(RunIdRecord(run))

    def close(self, at: float) -> None:
        """The host ends in order."""
        if self._is_closed:
            return
        self._is_closed = True
        self._records.append(EndRecord(at))
        self._write_batch()
        self._sink.close()

    def _write_batch(self) -> None:
        if not self._records:
            return
        records, self._records = self._records, []
        self._block_bytes = 0
        if not self._is_started:
            self._is_started = True
            metered = self._core.machine.hooks.meter is not None
            started = replace(self._start, metered=metered)
            self._sink.start_file(_frame([started], b"S", started.at))
        data = _frame(records, b"T", self._batch_at, self._turns)
        self._turns = 0
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
        data = _frame([record], b"C", now)
        if self._sink.is_full:
            self._sink.start_file(data)
        else:
            self._sink.append(data)


def block_digest(agent: str, block: Block) -> BlockDigest:
    """The digest of the used words of a block."""
    top = block.top
    return BlockDigest(agent, crc32(memoryview(block.data)[: 8 * top]), top)


def _frame(records: list[HostRecord], kind: bytes, at: float, turns: int = 0) -> bytes:
    return frame(encode_frame(records, FrameHeader(kind, at, turns)))

"""The moments of one host's recording: any moment can be reached and searched for, in both directions.

A moment is reached by replaying from the nearest checkpoint before it. Besides those of the recording there
are checkpoints in memory, which a replay makes as it advances.
"""

from __future__ import annotations

import time
from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from typing import Any

from lfield.bytecode.program import Program
from lfield.host.recording.host_records import CheckpointRecord, TurnRecord
from lfield.mission.mission import Mission
from lfield.replay.debugger.moment import Moment, Phase, ReplayState, Target
from lfield.replay.debugger.statement_table import StatementTable
from lfield.replay.debugger.stepping_engine import SteppingEngine
from lfield.replay.debugger.targets import is_of_readings
from lfield.replay.host_recording import HostRecording
from lfield.replay.host_replay import Divergence, HostReplay
from lfield.vm.engine_interface import Engine
from lfield.vm.memory.block import Block
from lfield.vm.reference import ReferenceEngine
from lfield.wire.events import Event

#: Seconds of replaying after which a checkpoint is made in memory, and the bytes of all of them.
CHECKPOINT_EVERY, MAX_CHECKPOINT_BYTES = 0.1, 128 << 20
#: Seconds of replaying, and turns that are only read, between two reports of progress.
REPORT_EVERY, REPORT_TURNS = 0.05, 1000
#: The bytes of events that are listed.
MAX_EVENT_BYTES = 1 << 20
#: Replays that are kept for use again: a rewind costs a quarter of a new one.
MAX_USED = 3

#: A turn, and the number of a moment in it: 0 after its input, then its statements, then its end.
Step = tuple[int, int]


class SearchCancelled(Exception):
    """A search has ended early: a function of `watch_progress` raised this. The position is unchanged."""


class HostTimeline:
    """One recording of a host of `mission`. `stopwatch` measures the cost of replaying, in seconds.

    `ats` are the times of the turns on the host's clock.
    """

    def __init__(
        self,
        recording: HostRecording,
        mission: Mission,
        table: StatementTable,
        stopwatch: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.recording, self.mission, self.table, self._stopwatch = recording, mission, table, stopwatch
        self.ats = array("d")
        for _, record in recording.turns_from(0):
            self.ats.append(record.at)
        #: Checkpoints in memory by turn, and their turns in order.
        self._checkpoints: dict[int, CheckpointRecord] = {}
        self._checkpoint_turns: list[int] = []
        self._checkpoint_bytes = 0
        #: A replay at rest, to continue forwards; and used ones, to rewind.
        self._idle: _Run | None = None
        self._used: list[_Run] = []
        #: The replay of the last returned moment.
        self._stopped: _Run | None = None
        #: The first turn whose replay differs from the recording, and the difference.
        self.divergence: tuple[int, Divergence] | None = None
        self._on_progress: Callable[[int], None] = lambda turn: None
        self._report_due = 0.0

    def watch_progress(self, on_progress: Callable[[int], None]) -> None:
        """Set the function that is called with the number of the turn that a replay has reached.

        It may raise SearchCancelled.
        """
        self._on_progress = on_progress

    @property
    def turns(self) -> int:
        """The number of turns."""
        return len(self.ats)

    # --- positions ------------------------------------------------------------------------------------

    def moment_at(self, step: Step) -> tuple[Moment, int]:
        """The moment at a position, and its number in the turn: at most that of the turn's end.

        After the last turn the result is a moment at rest.
        """
        turn, number = step
        run = self._run_at(min(turn, self.turns))
        if run.turn >= self.turns:
            return run.rest(), 0
        self._store_checkpoint(run)
        if self._stopped is not None:
            self._keep(self._stopped)
        self._stopped = run
        try:
            run.replay_turn(self.table.starts, lambda moment: _stop_at(moment, number))
        except _Reached as reached:
            return reached.moment, reached.moment.step
        raise AssertionError("a turn has an end")

    def rest_at(self, turn: int) -> Moment:
        """The moment before a turn, without its input; it is valid until the next call."""
        run = self._run_at(min(turn, self.turns))
        self._idle = run
        return run.rest()

    def events_before(self, turn: int, count: int) -> list[Event]:
        """The last events before a turn, at most so many."""
        back = 1
        while True:
            run = self._restored(self._nearest(max(0, turn - back)))
            first = run.turn
            self._advance(run, turn)
            recorder = run.rest().core.recorder
            recorder.drain()
            log = recorder.event_log
            found, _ = log.after(max(0, log.latest - count), count, MAX_EVENT_BYTES)
            self._keep(run)
            if len(found) == count or not first:
                return found
            back *= 4

    # --- search ---------------------------------------------------------------------------------------

    def find(self, target: Target, after: Step, before: Step, *, last: bool = False) -> Step | None:
        """The first, or `last`, moment between two positions (exclusive) that meets a target."""
        self._report_due = 0.0
        run = self._run_at(min(after[0], self.turns))
        target.start(run.rest())
        if is_of_readings(target):
            return self._find_reading(run, target, after, before, last=last)
        candidates: list[tuple[int, Step | None]] = []
        stop = min(self.turns, before[0] + (before[1] > 0))
        while run.turn < stop:
            turn = run.turn
            is_exact = target.stops is None or turn in (after[0], before[0])
            matches = run.search_turn(target, self.table.starts if is_exact else target.stops)
            self._on_replayed(run)
            if not is_exact and matches and not last and (step := self._first_of(target, turn)):
                self._idle = run
                return step
            steps = [(turn, number) for number in matches if after < (turn, number) < before]
            if is_exact and steps and not last:
                self._idle = run
                return steps[0]
            if matches and not is_exact:
                candidates.append((turn, None))
            elif steps:
                candidates.append((turn, steps[-1]))
        self._idle = run
        for turn, exact in reversed(candidates):
            if exact is not None:
                return exact
            if matches := self._matches_in(target, turn):
                return turn, matches[-1]
        return None

    def _find_reading(
        self, run: _Run, target: Target, after: Step, before: Step, *, last: bool
    ) -> Step | None:
        """`find` for readings of devices: they are in the records, so that no replay is needed."""
        match: Step | None = None
        for turn, record in self.recording.turns_from(after[0]):
            if (turn, 0) >= before:
                break
            if turn % REPORT_TURNS == 0:
                self._on_progress(turn)
            if isinstance(record, TurnRecord) and (record.answers or record.readings):
                is_met = target.is_met(run.with_readings_of(record))
                match = (turn, 0) if is_met and after < (turn, 0) else match
            if match and not last:
                break
        # The readings of that replay are not those of its turn any more.
        self._keep(run)
        return match

    def _first_of(self, target: Target, turn: int) -> Step | None:
        matches = self._matches_in(target, turn)
        return (turn, matches[0]) if matches else None

    def _matches_in(self, target: Target, turn: int) -> list[int]:
        """The numbers of the moments of a turn that meet a target."""
        run = self._restored(turn)
        target.start(run.rest())
        found = run.search_turn(target, self.table.starts)
        self._keep(run)
        return found

    # --- replays --------------------------------------------------------------------------------------

    def _run_at(self, turn: int) -> _Run:
        """A replay at rest before a turn."""
        idle, self._idle = self._idle, None
        if idle is not None and self._nearest(turn) <= idle.turn <= turn:
            self._advance(idle, turn)
            return idle
        if idle is not None:
            self._keep(idle)
        return self._restored(turn)

    def _keep(self, run: _Run) -> None:
        """Keep a replay that is not used any more, also one that was stopped within a turn."""
        if len(self._used) < MAX_USED:
            self._used.append(run)

    def _restored(self, turn: int) -> _Run:
        at = self._nearest(turn)
        checkpoint = self._checkpoints.get(at) or self.recording.checkpoint_before(at)[1]
        if checkpoint is not None and self._used:
            run = self._used.pop()
            run.rewind(at, checkpoint)
        else:
            run = _Run(self, at, checkpoint)
            self._store_checkpoint(run)
        self._advance(run, turn)
        return run

    def _nearest(self, turn: int) -> int:
        """The last turn up to `turn` at which there is a checkpoint."""
        number = bisect_right(self._checkpoint_turns, turn)
        in_memory = self._checkpoint_turns[number - 1] if number else -1
        return max(in_memory, self.recording.checkpoint_before(turn)[0])

    def _advance(self, run: _Run, turn: int) -> None:
        started = self._stopwatch()
        while run.turn < turn:
            run.replay_turn(frozenset(), None)
            self._on_replayed(run)
        if self._stopwatch() - started > CHECKPOINT_EVERY / 4:
            self._store_checkpoint(run)

    def _on_replayed(self, run: _Run) -> None:
        if run.divergence is not None:
            if self.divergence is None or run.divergence[0] < self.divergence[0]:
                self.divergence = run.divergence
            run.divergence = None
        now = self._stopwatch()
        if now >= run.checkpoint_due:
            self._store_checkpoint(run)
            run.checkpoint_due = self._stopwatch() + CHECKPOINT_EVERY
        if now >= self._report_due:
            self._report_due = now + REPORT_EVERY
            self._on_progress(run.turn)

    def _store_checkpoint(self, run: _Run) -> None:
        if run.turn in self._checkpoints or run.turn >= self.turns:
            return
        while self._checkpoint_bytes > MAX_CHECKPOINT_BYTES:
            # Every second checkpoint, so that the remaining ones cover the same time.
            for turn in self._checkpoint_turns[::2]:
                self._checkpoint_bytes -= len(self._checkpoints.pop(turn).snapshot)
            del self._checkpoint_turns[::2]
        self._checkpoints[run.turn] = checkpoint = run.replay.checkpoint()
        self._checkpoint_turns.insert(bisect_left(self._checkpoint_turns, run.turn), run.turn)
        self._checkpoint_bytes += len(checkpoint.snapshot)


class _Reached(BaseException):
    """Ends a replay that has reached a moment. Not an Exception, which would end an agent."""

    def __init__(self, moment: Moment) -> None:
        self.moment = moment
        super().__init__()


def _stop_at(moment: Moment, number: int) -> None:
    if moment.step == number or moment.phase is Phase.END:
        raise _Reached(moment)


class _Run:
    """A replay of a timeline from a checkpoint on, whose turns can be stopped at each moment."""

    def __init__(self, timeline: HostTimeline, turn: int, checkpoint: CheckpointRecord | None) -> None:
        self._table = timeline.table
        engines: list[SteppingEngine] = []

        def make(program: Program, now: Callable[[], float]) -> Engine:
            engines.append(SteppingEngine(ReferenceEngine(program, now)))
            return engines[0]

        self.replay = HostReplay(timeline.recording, timeline.mission, make, turn, checkpoint)
        self._engine, self._turns = engines[0], iter(self.replay)
        #: The turn at which the event log of the replay begins.
        self._origin = self.replay.turn
        self.divergence: tuple[int, Divergence] | None = None
        self.checkpoint_due = 0.0
        self._step = 0

    def rewind(self, turn: int, checkpoint: CheckpointRecord) -> None:
        """Go to a turn with the state before it."""
        self.replay.rewind(turn, checkpoint)
        self._turns = iter(self.replay)
        self.divergence, self._step, self._origin = None, 0, turn

    @property
    def turn(self) -> int:
        """The number of the next turn."""
        return self.replay.turn

    def with_readings_of(self, record: TurnRecord) -> Moment:
        """A moment with the readings of a later turn. After that the replay cannot continue, only rewind."""
        self.replay.environment.apply(record.answers, record.readings)
        return self._moment(Phase.INPUT, ())

    def rest(self) -> Moment:
        """The present moment, between two turns."""
        return self._moment(Phase.REST, ())

    def _moment(self, phase: Phase, effects: Any, block: Block | None = None, place: int = 0) -> Moment:
        state = ReplayState(self.replay.core, self.replay.environment, self._table, self._origin)
        return Moment(state, phase, self._step, effects, block, place)

    def search_turn(self, target: Target, stops: frozenset[int] | None) -> list[int]:
        """Replay the next turn; returns the numbers of its moments that meet a target."""
        found: list[int] = []

        def on_moment(moment: Moment) -> None:
            if target.is_met(moment):
                found.append(moment.step)

        self.replay_turn(self._table.starts if stops is None else stops, on_moment)
        return found

    def replay_turn(self, stops: frozenset[int], on_moment: Callable[[Moment], None] | None) -> None:
        """Replay the next turn; `on_moment` gets its moments: its input, these statements, its end."""
        self._step = 0
        replay, engine = self.replay, self._engine
        pending = replay.core.context.effects
        if on_moment is None:
            engine.watch(frozenset(), None)
            replay.watch_inputs(None)
        else:

            def probe(block: Block, place: int) -> None:
                self._step += 1
                on_moment(self._moment(Phase.STATEMENT, pending, block, place))

            engine.watch(stops, probe)
            replay.watch_inputs(lambda: on_moment(self._moment(Phase.INPUT, pending)))
        done = next(self._turns)
        if done.divergence is not None and self.divergence is None:
            self.divergence = done.number, done.divergence
        if on_moment is not None:
            self._step += 1
            on_moment(self._moment(Phase.END, done.effects))

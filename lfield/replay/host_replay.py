"""Replays one host: the real core on recorded inputs, compared turn by turn with the recording."""

from __future__ import annotations

import random
from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import replace
from operator import attrgetter
from typing import Any, NamedTuple

from msgspec import structs

from lfield.bytecode.program import Program
from lfield.errors import RecordingError
from lfield.host.context import HostContext
from lfield.host.core import HostCore
from lfield.host.effects import Effect
from lfield.host.events.event_recorder import EventRecorder
from lfield.host.recording.core_snapshot import CoreSnapshots
from lfield.host.recording.effect_summary import decode_effects, encode_effects
from lfield.host.recording.flight_recorder import block_digest
from lfield.host.recording.host_records import BlockDigest, CheckpointRecord, IdleTurn, TurnRecord
from lfield.hybrid_clock import timestamp_of
from lfield.mission.access.signed_bundle import BundleId
from lfield.mission.mission import Mission
from lfield.recording.turn_clocks import ReplayClock, ReplayedTimes
from lfield.replay.host_recording import HostRecording, Turn
from lfield.replay.replay_environment import ReplayedBytes, ReplayEnvironment
from lfield.replication.membership.overlay import Overlay
from lfield.vm.engine_interface import Engine, Engines, EngineWrapper
from lfield.vm.reference import ReferenceEngine
from lfield.vm.turns.run_limit import ReplayedRunLimit


class Divergence(NamedTuple):
    """The first difference in a turn: its subject, and the values in the recording and in the replay."""

    subject: str
    recorded: object
    replayed: object


class ReplayedTurn(NamedTuple):
    """A replayed turn: its number, its record, its effects, and its difference, None for none.

    `digests` is the number of digests and effects that were compared.
    """

    number: int
    record: Turn
    effects: list[Effect]
    divergence: Divergence | None
    digests: int


class HostReplay:
    """Replays `recording` of a host of `mission`, from its first turn or checkpoint on.

    `engines` makes the engine, by default the reference engine. `turn` is the number of the next turn: the
    replay begins there if `checkpoint` has the state before it, otherwise at the last one in the recording.
    """

    def __init__(
        self,
        recording: HostRecording,
        mission: Mission,
        engines: Engines = ReferenceEngine,
        turn: int = 0,
        checkpoint: CheckpointRecord | None = None,
    ) -> None:
        self.recording, self._engines, self.turn = recording, engines, turn
        if checkpoint is None:
            self.turn, checkpoint = recording.checkpoint_before(turn)
        self._on_input: Callable[[], None] | None = None
        start = self._start = recording.start if checkpoint is None else checkpoint.start
        mission = replace(mission, release=BundleId(*structs.astuple(start.release)))
        self.mission, team, program = mission, mission.team, mission.program
        self.clock = ReplayClock(start.at, start.wall)
        self.environment = ReplayEnvironment({each: n for n, each in enumerate(program.core.device_calls)})
        self._times = ReplayedTimes(self.clock)
        self._limit, self._bytes = ReplayedRunLimit(), ReplayedBytes()
        self._bytes.extend(start.drawn)
        recorder = EventRecorder(self.clock)
        recorder.hybrid_clock.restore(start.clock)
        overlay = Overlay(team.hosts, team.number(start.host), is_full_mesh=mission.registry is not None)
        context = HostContext(
            mission, start.host, start.incarnation, self.clock, self.environment, random.Random(start.seed),
            start.unreachable_after, overlay, recorder, start.journal_id, start.records, dict(start.times),
            with_pace(engines, start.pace), self._bytes, float, self._limit, self._times,
        )  # fmt: skip
        self.core = HostCore(context)
        if start.metered:
            self.core.machine.hooks.attach_meter(lambda executed: None)
        self._snapshots = CoreSnapshots(self.core, self._number_of)
        if checkpoint is not None:
            self._restore(checkpoint)
        self._turns = recording.turns_from(self.turn)
        #: The number of the next event that the core does not make.
        self._outside = self._outside_after(checkpoint)

    def watch_inputs(self, on_input: Callable[[], None] | None) -> None:
        """Set the function that is called in each turn after its input and before the core runs."""
        self._on_input = on_input

    def prepare(self, record: Turn) -> None:
        """Set times, answers and all other data that the core gets from outside in a turn, besides its
        input.
        """
        if isinstance(record, IdleTurn):
            record = TurnRecord(record.at)
        self.clock.set(record.at, record.wall)
        self.environment.apply(record.answers, record.readings)
        self._bytes.extend(record.drawn)
        self._times.set(record.times)
        self._limit.repeat(record.cuts)
        if record.clock is not None:
            self.core.recorder.hybrid_clock.restore(record.clock)

    def _number_of(self, reading: object) -> int:
        for number, each in enumerate(self.environment.readings):
            if each is reading:
                return number
        raise RecordingError("a checkpoint cannot contain a reading that was not recorded")

    def _restore(self, checkpoint: CheckpointRecord) -> None:
        self.environment.restore(checkpoint.answers, checkpoint.readings)
        try:
            self._snapshots.restore(checkpoint.snapshot, self.environment.readings)
        except RecordingError as error:
            start = self._start
            raise RecordingError(f"{start.host}, recorded by lfield {start.lfield}: {error}") from None
        self.core.recorder.hybrid_clock.restore(checkpoint.start.clock)
        self.clock.set(checkpoint.at, None)

    def rewind(self, turn: int, checkpoint: CheckpointRecord) -> None:
        """Go to a turn with the state before it, also after a turn that was not completed."""
        self.turn, self._start = turn, checkpoint.start
        self.environment.clear()
        self._bytes.clear()
        self.clock.set(checkpoint.at, checkpoint.start.wall)
        self._restore(checkpoint)
        self.core.recorder.restart()
        self._turns = self.recording.turns_from(turn)
        self._outside = self._outside_after(checkpoint)

    def checkpoint(self) -> CheckpointRecord:
        """The present state, between two turns: a replay can begin at `turn` with it."""
        start = structs.replace(
            self._start, wall=self.clock.wall, clock=self.core.recorder.hybrid_clock.state
        )
        environment = self.environment
        return CheckpointRecord(
            self.clock.at, start, self._snapshots.capture(), environment.answers, environment.reading_changes
        )

    def _outside_after(self, checkpoint: CheckpointRecord | None) -> int:
        found = self.recording.outside_events
        return 0 if checkpoint is None else bisect_right(found, checkpoint.at, key=attrgetter("at"))

    def _add_outside_events(self, number: int, at: float) -> None:
        """Log the events outside of the core up to a turn; with the last turn all that followed."""
        found, start = self.recording.outside_events, self._start
        is_last = number + 1 >= self.recording.turns
        while self._outside < len(found) and (is_last or found[self._outside].at <= at):
            event = found[self._outside]
            uptime = event.at - start.at
            wall = start.wall + uptime
            stamp = timestamp_of(max(0, int(wall * 1000.0)), 0)
            self.core.recorder.event_log.append(event.what, wall, max(0.0, uptime), 0, stamp)
            self._outside += 1

    def __iter__(self) -> Iterator[ReplayedTurn]:
        for number, record in self._turns:
            yield self._replay_safely(number, record)

    def _replay_safely(self, number: int, record: Turn) -> ReplayedTurn:
        """Replay a turn; a failure of the core, such as a refused input, is a difference."""
        try:
            return self._replay(number, record)
        except RecordingError:
            raise
        except Exception as error:
            found = Divergence("failure of the core", None, f"{type(error).__name__}: {error}")
            return ReplayedTurn(number, record, [], found, 1)

    def _replay(self, number: int, record: Turn) -> ReplayedTurn:
        core = self.core
        self._add_outside_events(number, record.at)
        self.prepare(record)
        if isinstance(record, IdleTurn):
            if self._on_input is not None:
                self._on_input()
            core.run()
            effects = core.drain_effects()
            self.turn = number + 1
            divergence = Divergence("effects", [], _plain(effects)) if effects else None
            return ReplayedTurn(number, record, effects, divergence, 1)
        if record.entry is not None:
            record.entry.enter(core)
        if self._on_input is not None:
            self._on_input()
        if record.run:
            core.run()
        effects = core.drain_effects() if record.run else []
        self.turn = number + 1
        divergence = self._compare(record.effects, effects, record.digests)
        return ReplayedTurn(number, record, effects, divergence, 1 + len(record.digests))

    def _compare(
        self, recorded: bytes, effects: list[Effect], digests: list[BlockDigest]
    ) -> Divergence | None:
        replayed = encode_effects(effects)
        if recorded != replayed:
            return _first_difference(decode_effects(recorded), decode_effects(replayed))
        agents = self.core.machine.agents
        found = {name: block_digest(name, agents[name].block) for name in agents} if digests else {}
        if digests and found.keys() != {each.agent for each in digests}:
            return Divergence("agents of the host", sorted(each.agent for each in digests), sorted(found))
        for each in digests:
            if found[each.agent] != each:
                return Divergence(f"block of {each.agent}", each, found[each.agent])
        return None


def with_pace(engines: Engines, pace: int) -> Engines:
    """The same engines with the pace of another one: turns then have the same budgets."""

    def make(program: Program, now: Callable[[], float]) -> Engine:
        return PacedEngine(engines(program, now), pace)

    return make


class PacedEngine(EngineWrapper):
    """An engine with another pace."""

    def __init__(self, engine: Engine, pace: int) -> None:
        super().__init__(engine)
        self.pace = pace


def _plain(effects: list[Effect]) -> list[list[Any]]:
    return decode_effects(encode_effects(effects))


def _first_difference(recorded: list[list[Any]], replayed: list[list[Any]]) -> Divergence:
    for number in range(max(len(recorded), len(replayed))):
        recorded_effect = recorded[number] if number < len(recorded) else None
        replayed_effect = replayed[number] if number < len(replayed) else None
        if recorded_effect != replayed_effect:
            return Divergence(f"effect {number + 1}", recorded_effect, replayed_effect)
    return Divergence("effects", recorded, replayed)

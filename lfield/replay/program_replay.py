"""Runs a program on the recorded world of a team: readings, answers of devices, messages and links.

The recorded program makes the recorded calls. Another program gets the same answers as long as it makes the
same calls: the answer to an agent's n-th device call is that of the recorded n-th one, and a coordinator
arrives with the block that this program has sent. A batch of records is durable when the recorded one of
that number was, or at once after that.

Another program may pause where the recorded one did not. So a coordinator arrives after this program has sent
it, also if the recorded one was earlier, a confirmation of a hop waits for the hop, a probe of another host
is answered at once, and the program gets time after the end of the recording.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count

from lfield.bytecode.program import DeviceCallRecord, Program
from lfield.errors import RecordingError
from lfield.host.effects import CallDevice, Effect, PersistRecords, WakeWaiters
from lfield.host.inputs import (
    AgentsHalt,
    BatchDurable,
    DeviceAnswered,
    HostInput,
    MessageArrived,
    TransferArrived,
)
from lfield.host.recording.effect_summary import decode_effects
from lfield.host.recording.host_records import IdleTurn, RecordedAnswer, TurnRecord
from lfield.host.recording.recorded_environment import Question
from lfield.mission.mission import Mission
from lfield.replay.call_log import CallLog
from lfield.replay.computation_limit import ComputationLimit
from lfield.replay.host_recording import HostRecording, Turn
from lfield.replay.host_replay import HostReplay
from lfield.replay.recording_files import TeamRecording
from lfield.replay.team_order import TeamOrder, TransferKey, arrival_in
from lfield.replication.transfer.effects import Send, SendTransfer
from lfield.vm.agent import Agent
from lfield.vm.engine_interface import Engines
from lfield.vm.inspection.traceback import innermost
from lfield.vm.memory.block import Block
from lfield.vm.reference import ReferenceEngine
from lfield.wire.coordinator_messages import TransferAccepted
from lfield.wire.events import AgentFinished, MigrationStarted
from lfield.wire.messages import QUESTION, Ping, Pong

#: The blocks that were sent, with their headers as the receiver gets them.
SentBlocks = dict[TransferKey, TransferArrived]
#: Seconds that another program has after the end of the recording, and between two turns there.
EXTRA_TIME, EXTRA_TURN = 60.0, 0.05
#: The events that are read at once: their number, and their bytes.
MAX_EVENTS, MAX_EVENT_BYTES = 100_000, 16 << 20


class ProgramRun:
    """One host that runs a program on a recording; `log` gets its calls, `sent` its departures.

    With `recorded_log`, the calls of the recorded program, the program is another one: the end of the
    recorded host does not end it.
    """

    def __init__(
        self,
        recording: HostRecording,
        mission: Mission,
        recorded: Program,
        engines: Engines,
        log: CallLog,
        sent: SentBlocks,
        recorded_log: CallLog | None = None,
    ) -> None:
        self._is_other = recorded_log is not None
        self._log, self._sent = log, sent
        known = None if recorded_log is None else recorded_log.longest_computation
        self._limit = ComputationLimit(lambda: self._at, known, self._on_endless_computation)
        self._replay = HostReplay(recording, mission, self._limit.limited(engines))
        self._core, self._host = self._replay.core, recording.host
        self._replay.environment.use_calls(numbers_of(mission.program, recorded))
        self._replay.environment.preset(_first_answers(recording))
        self._core.machine.hooks.replace_observer(PortalCallObserver(self))
        self._at = 0.0
        #: The agent and the position among its calls of each recorded device call, by number.
        self._recorded: dict[int, tuple[str, int]] = {}
        self._counts: dict[str, count[int]] = {}
        #: The numbers of this program's calls by agent and position, and answers that came before their call.
        self._call_numbers: dict[tuple[str, int], int] = {}
        self._made_counts: dict[str, count[int]] = {}
        self._early: dict[tuple[str, int], DeviceAnswered] = {}
        #: Inputs about a coordinator, by sender and coordinator, that wait for an action of this program.
        self._held: dict[tuple[str, str], deque[TurnRecord]] = {}
        #: The last batch of this program; of the recorded one the last durable batch until now, and of all.
        self._issued, self._durable, self._last_durable = 0, 0, _last_durable(recording)
        #: The number of the last event that was read, and the departures that were read.
        self._last_event = 0
        self._departures: dict[TransferKey, MigrationStarted] = {}
        #: The time when the recorded host halted its agents, as a common time of the team; infinite before.
        self.halted_at = math.inf

    def turn(self, record: Turn, at: float) -> None:
        """Replay a turn, at a common time of the team."""
        self._at = at
        self._replay.prepare(record)
        entry: HostInput | None = None
        if isinstance(record, TurnRecord):
            entry = None if self._hold(record) else self._entry(record)
        self._run(entry, runs=isinstance(record, IdleTurn) or record.run)
        self._release()
        if isinstance(record, TurnRecord):
            self._number_recorded(record)

    def extra_turn(self, seconds: float) -> None:
        """A turn at so many seconds after the last recorded one."""
        self._replay.clock.set(self._replay.recording.ended_at + seconds, None)
        self._run(None)
        self._release()

    def _run(self, entry: HostInput | None, *, runs: bool = True) -> None:
        if entry is not None:
            entry.enter(self._core)
        if runs:
            self._core.run()
            self._execute(self._core.drain_effects())

    def _hold(self, record: TurnRecord) -> bool:
        """Keep an input that is early for this program, or that follows such an input; returns false for
        any other.
        """
        about = _about(record.entry)
        if about is None or not (about in self._held or self._is_early(record)):
            return False
        self._held.setdefault(about, deque()).append(record)
        return True

    def _is_early(self, record: TurnRecord) -> bool:
        """Whether an input concerns a hop that this program has not made yet."""
        entry = record.entry
        if isinstance(entry, TransferArrived):
            hop = arrival_in(self._host, record)
            return hop is not None and hop not in self._sent
        if isinstance(entry, MessageArrived) and isinstance(entry.message, TransferAccepted):
            found = entry.message
            return TransferKey(found.agent, found.generation, found.sequence, entry.host) not in self._sent
        return False

    def _release(self) -> None:
        """Pass on the inputs that are not early any more."""
        for about, waiting in list(self._held.items()):
            while waiting and not self._is_early(waiting[0]):
                self._run(self._entry(waiting.popleft()))
            if not waiting:
                del self._held[about]

    @property
    def missed_calls(self) -> int:
        """The number of recorded device calls that were not made."""
        return len(self._recorded) - len(self._call_numbers)

    @property
    def longest_computation(self) -> int:
        """The most instructions that a thread has executed without a call or a pause."""
        return self._limit.longest

    def _on_endless_computation(self, agent: str, block: Block, thread: int, since: float) -> None:
        self._log.add_computation(
            self._core, agent, innermost(block, self._core.machine.program, thread), since
        )

    def on_portal_call(self, resource: Agent, method: int, caller: str) -> None:
        """Record that a portal has started for a coordinator."""
        self._log.add_portal_call(self._core, caller, resource, method, self._at)

    def _entry(self, record: TurnRecord) -> HostInput | None:
        """The input of a turn for this program; None for none."""
        entry: HostInput | None = record.entry
        match entry:
            case BatchDurable():
                self._durable = entry.number
                return BatchDurable(min(entry.number, self._issued)) if self._issued else None
            case AgentsHalt():
                self.halted_at = min(self.halted_at, self._at)
                return None if self._is_other else entry
            case TransferArrived():
                hop = arrival_in(self._host, record)
                return None if hop is None else self._sent.get(hop)
            case DeviceAnswered():
                key = self._recorded.get(entry.number)
                if key is None:
                    return None
                number = self._call_numbers.get(key)
                if number is None:
                    self._early[key] = entry
                    return None
                return DeviceAnswered(number, entry.value, entry.error)
        return entry

    def _execute(self, effects: Iterable[Effect]) -> None:
        for effect in effects:
            match effect:
                case CallDevice():
                    self._on_device_call(effect)
                case SendTransfer():
                    header = effect.header
                    hop = TransferKey(header.agent, header.generation, header.sequence, effect.host)
                    block = memoryview(bytes(effect.block))
                    self._sent[hop] = TransferArrived(self._host, header, block)
                case Send(host=host, message=Ping(token=token)) if self._is_other and token == QUESTION:
                    # The recorded program may have probed this host at another time, or not at all.
                    self._run(MessageArrived(host, Pong(QUESTION)))
                case WakeWaiters():
                    self.read_events()
                case PersistRecords():
                    self._issued = effect.number
                    if effect.number <= self._durable or effect.number > self._last_durable:
                        self._run(BatchDurable(effect.number))

    def read_events(self) -> None:
        """Record the agents that have ended or left since the last call."""
        recorder = self._core.recorder
        recorder.drain()
        log = recorder.event_log
        found, _ = log.after(self._last_event, MAX_EVENTS, MAX_EVENT_BYTES)
        self._last_event = log.latest
        for event in found:
            match event.what:
                case AgentFinished(agent=agent):
                    self._log.ended.add(agent)
                case MigrationStarted(portal=portal) as departure if portal:
                    key = TransferKey(departure.agent, departure.generation, departure.sequence, departure.to)
                    self._departures[key] = departure

    def log_departures(self, order: TeamOrder, ended: Collection[str]) -> None:
        """Log the portal calls of hops that are not in the recording, of agents whose recorded ones ended."""
        self.read_events()
        for hop in [*self._departures.keys() - order.sends.keys()]:
            departure = self._departures.pop(hop)
            if departure.agent in ended:
                self._log.add_departure(
                    self._core, departure.agent, f"{departure.resource}.{departure.portal}", self._at
                )

    def _on_device_call(self, command: CallDevice) -> None:
        self._log.add_device_call(self._core, command, self._at)
        agent = command.agent.id
        key = agent, next(self._made_counts.setdefault(agent, count()))
        self._call_numbers[key] = command.number
        if (answer := self._early.pop(key, None)) is not None:
            self._run(DeviceAnswered(command.number, answer.value, answer.error))

    def _number_recorded(self, record: TurnRecord) -> None:
        """Record the device calls that the recorded program made in this turn."""
        if b"CallDevice" not in record.effects:
            return
        for effect in decode_effects(record.effects):
            if effect[0] == "CallDevice":
                agent = effect[1]
                self._recorded[effect[-1]] = agent, next(self._counts.setdefault(agent, count()))


def _last_durable(recording: HostRecording) -> int:
    """The number of the last batch of records that was durable."""
    turns = (turn for _, turn in recording.turns_from(0) if isinstance(turn, TurnRecord))
    return max((turn.entry.number for turn in turns if isinstance(turn.entry, BatchDurable)), default=0)


def _first_answers(recording: HostRecording) -> Iterator[RecordedAnswer]:
    """The answers to queries, and of devices about their state; a reading is known from its turn on."""
    for _, turn in recording.turns_from(0):
        if isinstance(turn, TurnRecord):
            yield from (answer for answer in turn.answers if answer.question != Question.READING)


class PortalCallObserver:
    """The observer of a machine's portal calls."""

    def __init__(self, run: ProgramRun) -> None:
        self._run = run

    def on_call_started(self, resource: Agent, thread: int, number: int, method: int, caller: str) -> None:
        """Called when a portal (by index) has started."""
        self._run.on_portal_call(resource, method, caller)

    def on_call_returned(self, resource: Agent, number: int, result: int) -> None:
        """Called when a portal has returned."""

    def on_call_threw(self, resource: Agent, number: int, thrown: int) -> None:
        """Called when a portal has ended by an exception."""

    def on_resource_died(self, resource: Agent, reason: str) -> None:
        """Called when a resource has died."""


def run_program(
    recording: TeamRecording,
    order: TeamOrder,
    mission: Mission,
    engines: Engines = ReferenceEngine,
    recorded: CallLog | None = None,
) -> CallLog:
    """The calls of a mission's program on the recorded world. Raises RecordingError.

    `recorded` are the calls of the recorded program, if this program is another one.
    """
    log, sent = CallLog(), SentBlocks()
    arguments = mission, recording.mission.program, engines, log, sent
    runs = [ProgramRun(part, *arguments, recorded) for part in order.parts]
    last = 0.0
    for turn in order:
        runs[turn.part].turn(turn.record, turn.at)
        last = turn.at
    log.end(min([last, *(run.halted_at for run in runs)]), sum(run.missed_calls for run in runs))
    log.longest_computation = max(run.longest_computation for run in runs)
    if recorded is not None:
        _run_on(runs, order, log, recorded)
    return log


def _run_on(runs: Sequence[ProgramRun], order: TeamOrder, log: CallLog, recorded: CallLog) -> None:
    """Give another program time after the end of the recording, for late calls and for new ones."""
    seconds = 0.0
    while seconds < EXTRA_TIME and log.may_follow(recorded):
        for run in runs:
            run.log_departures(order, recorded.ended)
            run.extra_turn(seconds)
        seconds += EXTRA_TURN


def _about(entry: HostInput | None) -> tuple[str, str] | None:
    """The sender and the coordinator of an input from another host; None for any other input."""
    match entry:
        case TransferArrived(host=host, header=header):
            return host, header.agent
        case MessageArrived(host=host, message=message) if isinstance(getattr(message, "agent", None), str):
            return host, getattr(message, "agent", "")
    return None


def mission_with(recording: TeamRecording, mission: Mission) -> Mission:
    """Another version of the recorded mission, with the recorded devices and addresses.

    Raises RecordingError if its team is another one.
    """
    recorded = recording.mission
    before, now = recorded.team, mission.team
    if before.hosts != now.hosts or [m.id for m in before.members] != [m.id for m in now.members]:
        raise RecordingError("its deployment has other hosts or agents than that of the recording")
    if any(not part.is_from_start for each in recording.incarnations for part in each.parts):
        raise RecordingError("another program needs the beginning of the recording, which is missing")
    team = now.at(before.addresses_by_host)
    return replace(mission, team=team, bindings=recorded.bindings, drivers=recorded.drivers)


def numbers_of(program: Program, recorded: Program) -> Mapping[DeviceCallRecord, int]:
    """The numbers that the recorded program gives to the device calls of a program.

    A call that the recorded program does not make has a number that is not in the recording.
    """
    known = {_key(recorded, call): number for number, call in enumerate(recorded.core.device_calls)}
    unknown = count(len(known))
    numbers: dict[DeviceCallRecord, int] = {}
    for call in program.core.device_calls:
        key = _key(program, call)
        numbers[call] = known[key] if key in known else next(unknown)
    return numbers


def _key(program: Program, call: DeviceCallRecord) -> tuple[str, str, str]:
    return program.core.classes[call.owner].name, call.field, call.instruction

"""Replays all hosts of a recording and compares them with it: the report of `lfield replay`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from msgspec import Struct, field

from lfield.bytecode.program import Program
from lfield.guard.recording.guard_replay import GuardReplay, replay_guard
from lfield.guard.recording.guard_segments import NO_RECORD, rings_in
from lfield.host.core import HostCore
from lfield.replay.host_recording import HostRecording
from lfield.replay.host_replay import HostReplay, ReplayedTurn
from lfield.replay.recording_files import Incarnation, TeamRecording
from lfield.vm.agent import Agent
from lfield.vm.engine_interface import Engines
from lfield.vm.inspection.traceback import FrameLocation, innermost
from lfield.vm.memory.threads import threads
from lfield.vm.reference import ReferenceEngine

#: Called with the number of turns that were replayed since the last call.
OnProgress = Callable[[int], None]
#: Turns between two calls.
PROGRESS_TURNS = 500


class FirstDifference(Struct, frozen=True):
    """The first difference of a replay from its recording.

    `at` is the time of the turn in seconds since 1970, by the clock of the host at its start; `turn` its
    number; `agent` and `place` (file:line of L) are '' if no agent is concerned.
    """

    host: str
    at: float
    turn: int
    agent: str
    place: str
    subject: str
    recorded: object
    replayed: object

    def as_data(self) -> dict[str, object]:
        """The difference as JSON data."""
        return {
            "host": self.host,
            "time": self.at,
            "turn": self.turn,
            "agent": self.agent,
            "place": self.place,
            "what": self.subject,
            "recorded": plain(self.recorded),
            "replayed": plain(self.replayed),
        }


class PartResult(Struct):
    """The result of one part of a recording; `seconds` is the time that it covers.

    `guard` is the first device of a guard, '' for the core of the host.
    """

    host: str
    incarnation: int
    turns: int = 0
    digests: int = 0
    seconds: float = 0.0
    first: FirstDifference | None = None
    guard: str = ""

    @property
    def differences(self) -> int:
        """1 if it differs, else 0: after its first difference a host is not replayed further."""
        return int(self.first is not None)


class ReplaySummary(Struct):
    """The results of all parts, in the order in which they were replayed."""

    parts: list[PartResult] = field(default_factory=list)

    @property
    def digests(self) -> int:
        """The number of digests and effects that were compared."""
        return sum(part.digests for part in self.parts)

    @property
    def differences(self) -> int:
        """The number of parts that differ."""
        return sum(part.differences for part in self.parts)

    @property
    def first(self) -> FirstDifference | None:
        """The earliest difference, None if all turns are equal."""
        found = [part.first for part in self.parts if part.first is not None]
        return min(found, key=lambda each: each.at, default=None)


def check_team(
    recording: TeamRecording, engines: Engines = ReferenceEngine, on_progress: OnProgress = lambda turns: None
) -> ReplaySummary:
    """Replay all hosts. Raises RecordingError for a checkpoint that cannot be restored."""
    result = ReplaySummary()
    for incarnation in recording.incarnations:
        for part in incarnation.parts:
            result.parts.append(check_part(part, HostReplay(part, recording.mission, engines), on_progress))
    return result


def check_part(
    recording: HostRecording, replay: HostReplay, on_progress: OnProgress = lambda turns: None
) -> PartResult:
    """Replay one part up to its first difference."""
    result = PartResult(recording.host, recording.start.incarnation)
    first = recording.started_at
    for turn in replay:
        result.turns += 1
        result.digests += turn.digests
        result.seconds = turn.record.at - first
        if result.turns % PROGRESS_TURNS == 0:
            on_progress(PROGRESS_TURNS)
        if turn.divergence is not None:
            result.first = difference_at(replay, turn)
            break
    on_progress(result.turns % PROGRESS_TURNS)
    return result


def check_guards(recording: TeamRecording) -> tuple[list[PartResult], list[str]]:
    """The result for the guard of each bus, and the unreadable parts, a sentence each."""
    results: list[PartResult] = []
    problems: list[str] = []
    for incarnation in recording.incarnations:
        for device, paths in rings_in(incarnation.folder).items():
            replay = replay_guard(paths)
            results.append(_guard_result(incarnation, device, replay))
            reasons = {**dict.fromkeys(replay.missing, NO_RECORD), **replay.cut}
            problems += (
                f"{incarnation.folder}: {path.relative_to(incarnation.folder)}: {reason}"
                for path, reason in reasons.items()
            )
    return results, problems


def _guard_result(incarnation: Incarnation, device: str, replay: GuardReplay) -> PartResult:
    start = incarnation.parts[0].start
    found = PartResult(incarnation.host, start.incarnation, guard=device)
    found.digests = replay.digests
    if (first := replay.first) is not None:
        subject = f"decision of the guard of {device} about {first.input}"
        found.first = FirstDifference(
            incarnation.host, first.wall_time, 0, "", "", subject, first.recorded, first.replayed
        )
    return found


def difference_at(replay: HostReplay, turn: ReplayedTurn) -> FirstDifference:
    """The difference of a turn that was just replayed, with the position of the agent that it concerns."""
    divergence, start = turn.divergence, replay.recording.start
    assert divergence is not None
    agent = _agent_of(divergence.subject, divergence.replayed, divergence.recorded)
    place = position(replay.core, agent)
    at = turn.record.at - start.at + start.wall
    values = divergence.recorded, divergence.replayed
    return FirstDifference(start.host, at, turn.number, agent, place, divergence.subject, *values)


def position(core: HostCore, agent: str) -> str:
    """The file and line of the innermost frame of an agent's most recent thread; '' for none."""
    found = core.machine.agents.get(agent)
    location = None if found is None else location_of(found, core.machine.program)
    return "" if location is None else f"{location.file}:{location.line}"


def location_of(agent: Agent, program: Program) -> FrameLocation | None:
    """The position of an agent's youngest thread; None for one without threads."""
    places = list(threads(agent.block))
    return innermost(agent.block, program, places[0]) if places else None


def plain(value: object) -> Any:
    """A value as JSON data: bytes in hex."""
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, dict):
        return {str(name): plain(each) for name, each in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)) and not hasattr(value, "_fields"):
        return [plain(each) for each in value]
    if hasattr(value, "__struct_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__struct_fields__}
    return value


def _agent_of(subject: str, *values: object) -> str:
    """The agent that a difference concerns: that of the block, or the one that an effect names."""
    if subject.startswith("block of "):
        return subject.removeprefix("block of ")
    return next(iter(_names(values)), "")


def _names(values: Iterable[object]) -> Iterable[str]:
    for value in values:
        match value:
            case ["CallDevice" | "CancelCall" | "WriteOutput" | "DumpAgent", str(agent), *_]:
                yield agent
            case ["SendTransfer", _, str(agent), *_]:
                yield agent

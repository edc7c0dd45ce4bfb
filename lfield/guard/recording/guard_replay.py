"""Replays the recorded inputs of a guard on its core, and compares the decisions.

Each segment starts with a state of the core. The decision about each input is compared, and at the start of
the next segment the whole state.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import msgspec

from lfield.guard.core import GuardCore
from lfield.guard.effects import Execute, Interrupt
from lfield.guard.messages import GuardCall
from lfield.guard.recording.guard_inputs import CallStarting, GuardInput, apply_input
from lfield.guard.recording.guard_records import (
    InputRecord,
    Pulses,
    SegmentStart,
    copy_state,
    decision_text,
    decisions_of,
    encode_state,
)
from lfield.guard.recording.guard_segments import GuardSegment, read_segments
from lfield.guard.recording.heartbeat_pulses import pulses_in
from lfield.recording.turn_clocks import ReplayClock

#: The recorded form of no decisions.
_NOTHING = b"\x90"


class GuardDifference(msgspec.Struct, frozen=True):
    """A decision that differs: the file, the monotonic and the wall-clock time in seconds, the input, and
    both decisions in words.
    """

    path: Path
    time: float
    wall_time: float
    input: str
    recorded: str
    replayed: str


class GuardReplay(msgspec.Struct):
    """The result: compared decisions and states (`digests`), the number of differences, and the first one.

    `cut` has the files with an unreadable end, and the reasons; `missing` has the files without any record.
    """

    digests: int = 0
    differences: int = 0
    first: GuardDifference | None = None
    cut: dict[Path, str] = msgspec.field(default_factory=dict)
    missing: list[Path] = msgspec.field(default_factory=list)

    def compare(self, recorded: bytes, replayed: bytes, difference: GuardDifference | None = None) -> bool:
        """Counts a comparison; returns whether both are equal."""
        self.digests += 1
        self.differences += recorded != replayed
        if recorded != replayed and self.first is None:
            self.first = difference
        return recorded == replayed


def replay_guard(paths: Iterable[Path]) -> GuardReplay:
    """Replays the files of one ring, oldest first. Raises RecordingError."""
    result, before, replayer = GuardReplay(), None, None
    for segment in read_segments(paths):
        if segment.end.reason:
            result.cut[segment.path] = segment.end.reason
        if segment.start is None:
            result.missing.append(segment.path)
            continue
        if replayer is not None and segment.follows(before):
            replayer.compare_state(segment.start, segment.path)
        replayer = _Replayer(segment.start, segment.path, result)
        replayer.replay(segment)
        before = segment
    return result


class _Replayer:
    """The core of one segment."""

    def __init__(self, start: SegmentStart, path: Path, result: GuardReplay) -> None:
        self._start, self._path, self._result = start, path, result
        self._clock = ReplayClock()
        self._core = GuardCore([], self._clock, silence=start.silence)
        self._core.restore(copy_state(start.state))
        self._unstarted: dict[int, GuardCall] = {call.token: call for call in start.unstarted}

    def replay(self, segment: GuardSegment) -> None:
        """Passes all inputs of a segment to the core."""
        for record in segment.records:
            if isinstance(record, Pulses):
                for time, event in pulses_in(record):
                    self._replay_input(time, event, _NOTHING)
            elif isinstance(record, InputRecord):
                self._replay_input(record.time, record.input, bytes(record.decisions))

    def _replay_input(self, time: float, event: GuardInput | CallStarting, recorded: bytes) -> None:
        self._clock.set(time)
        try:
            replayed = self._decisions(event)
        except Exception as error:  # of an input that the core does not accept, in a damaged recording
            replayed = msgspec.msgpack.encode(f"failure of the core: {type(error).__name__}: {error}")
        if recorded == replayed or self._result.first is not None:
            self._result.compare(recorded, replayed)
        else:
            texts = str(event), decision_text(recorded), decision_text(replayed)
            self._result.compare(recorded, replayed, self._difference(time, *texts))

    def _decisions(self, event: GuardInput | CallStarting) -> bytes:
        if isinstance(event, CallStarting):
            return self._start_call(event)
        effects = apply_input(self._core, event)
        for effect in effects:
            if isinstance(effect, Execute):
                self._unstarted[effect.call.token] = effect.call
            elif isinstance(effect, Interrupt):
                self._unstarted.pop(effect.token, None)
        return bytes(decisions_of(effects))

    def _start_call(self, event: CallStarting) -> bytes:
        call = self._unstarted.pop(event.token, None)
        if call is None:
            return msgspec.msgpack.encode("no call of this token was accepted")
        return msgspec.msgpack.encode(self._core.mark_started(call))

    def compare_state(self, start: SegmentStart, path: Path) -> None:
        """Compares the state with the state at the start of the next segment."""
        recorded, replayed = encode_state(start.state), encode_state(self._core.state)
        texts = f"the state at the start of {path.name}", str(start.state), str(self._core.state)
        self._result.compare(recorded, replayed, self._difference(start.monotonic, *texts))

    def _difference(self, time: float, event: str, recorded: str, replayed: str) -> GuardDifference:
        wall_time = self._start.wall_time + time - self._start.monotonic
        return GuardDifference(self._path, time, wall_time, event, recorded, replayed)

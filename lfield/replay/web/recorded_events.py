"""Index of the events of a recording by time: the events that the cores emit while they are replayed.

The recordings are replayed once, a turn at a time, so that the caller can do other work in between. Until
the end, the index has the events up to a time.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Sequence
from operator import itemgetter
from typing import NamedTuple

from lfield.host.core import HostCore
from lfield.host.effects import WriteLog
from lfield.replay.debugger.team_timeline import TeamTimeline
from lfield.replay.host_replay import HostReplay
from lfield.wire.events import Event

#: Events of one turn.
_MAX_EVENTS, _MAX_BYTES = 1 << 16, 1 << 28


class IndexedEvent(NamedTuple):
    """An event of a recording, by its number in the timeline; `time` is in seconds since its start.

    `serial` counts the events in the order in which they were added: the order of equal times.
    """

    time: float
    recording: int
    serial: int
    event: Event


class EventIndex:
    """The events of all recordings of a team, in the order of their times."""

    def __init__(self, team: TeamTimeline) -> None:
        self._times = team.times
        self._replays = [HostReplay(host.recording, team.mission) for host in team.hosts]
        self._turns = [iter(replay) for replay in self._replays]
        self._latest = [0] * len(self._replays)
        self._done = [0] * len(self._replays)
        self._total = sum(len(times) for times in self._times)
        self._events: list[IndexedEvent] = []
        self._serial = 0
        #: The parts that could not be replayed, a sentence each.
        self.problems: list[str] = []

    @property
    def progress(self) -> float:
        """The share of the turns that are replayed, from 0 to 1."""
        return sum(self._done) / self._total

    @property
    def is_complete(self) -> bool:
        """Whether all turns are replayed."""
        return sum(self._done) == self._total

    def advance(self) -> None:
        """Replay the earliest turn that is not replayed yet, if there is one."""
        open_ones = [n for n, times in enumerate(self._times) if self._done[n] < len(times)]
        if open_ones:
            self._replay_turn(min(open_ones, key=lambda n: self._times[n][self._done[n]]))

    def add(self, time: float, recording: int, event: Event) -> None:
        """Add an event from another source."""
        self._serial += 1
        insort(self._events, IndexedEvent(time, recording, self._serial, event))

    @property
    def count(self) -> int:
        """The number of events."""
        return len(self._events)

    def count_before(self, time: float) -> int:
        """The number of events before a time."""
        return bisect_left(self._events, time, key=itemgetter(0))

    def events(self, first: int, stop: int) -> Sequence[IndexedEvent]:
        """Events by their positions in the order."""
        return self._events[first:stop]

    def _replay_turn(self, number: int) -> None:
        at = self._times[number][self._done[number]]
        turn = next(self._turns[number])
        self._done[number] += 1
        core = self._replays[number].core
        if turn.divergence is not None:
            self.problems.append(
                f"the recording of {core.name} cannot be replayed beyond {at:.3f} s: "
                "'lfield replay' shows the difference"
            )
            self._done[number] = len(self._times[number])
            return
        for effect in turn.effects:
            if isinstance(effect, WriteLog) and not effect.is_recorded:
                core.recorder.on_log_line(effect.text)
        for event in self._new_events(number, core):
            # Events of the creation of the core are earlier than its first turn.
            self.add(max(self._times[number][0], at - (core.recorder.uptime - event.up)), number, event)

    def _new_events(self, number: int, core: HostCore) -> list[Event]:
        core.recorder.drain()
        found, _ = core.recorder.event_log.after(self._latest[number], _MAX_EVENTS, _MAX_BYTES)
        self._latest[number] = found[-1].number if found else self._latest[number]
        return found

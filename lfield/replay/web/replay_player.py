"""The position of the page: moves to a time or by steps, and playing. It has no clock or thread."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Iterator
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from lfield.replay.debugger.debugger import Debugger
from lfield.replay.debugger.moment import Moment, Target
from lfield.replay.debugger.targets import HopTarget, StatementTarget
from lfield.replay.debugger.team_timeline import Place
from lfield.replay.web.recorded_events import EventIndex, IndexedEvent

#: A number of a moment that no turn has: it stands for the end of the turn.
_END = 1 << 30
#: The error of times that are computed in two ways, in seconds.
_TOLERANCE = 1e-7


class Superseded(BaseException):
    """A search has ended because of a newer command. Not an Exception, which would end an agent."""


class ReplayCommand(Struct, frozen=True, forbid_unknown_fields=True):
    """A command of the page: to a time, by a step, or to play or pause.

    `seconds` is since the start of the recordings. `speed` is that of playing, 1 for real time. A statement
    is one of `agent`, of any agent if that is ''.
    """

    go: Literal["time", "event", "statement", "hop", "play", "pause"]
    seconds: Annotated[float, Meta(ge=0.0)] = 0.0
    backward: bool = False
    speed: Annotated[float, Meta(ge=0.1, le=100.0)] = 1.0
    agent: Annotated[str, Meta(max_length=1000)] = ""


def command_of(body: object) -> ReplayCommand | str:
    """The command in the body of a request, or the reason why the body has none."""
    try:
        command = msgspec.convert(body, ReplayCommand)
    except msgspec.ValidationError as error:
        return f"not a command of the replay: {error}"
    return (
        command if math.isfinite(command.seconds) else "not a command of the replay: seconds are not finite"
    )


class ReplayPlayer:
    """Moves a debugger. `is_superseded` tells whether a search should end because of a newer command.

    Steps to events need the index of `events`.
    """

    def __init__(self, debugger: Debugger, events: EventIndex, is_superseded: Callable[[], bool]) -> None:
        self._debugger, self._events, self._is_superseded = debugger, events, is_superseded
        #: The speed of playing, 0 while it is paused.
        self.speed = 0.0
        #: The start of playing by the caller's clock, and the position at that time.
        self._started_at = self._from = 0.0
        #: The reason why the last step did not move, '' if it did.
        self.problem = ""

    def execute(self, command: ReplayCommand, now: float) -> None:
        """Execute a command; `now` is a monotonic time."""
        debugger, self.problem = self._debugger, ""
        self.speed = 0.0
        match command.go:
            case "time":
                debugger.go_to_time(command.seconds)
            case "play":
                if debugger.seconds >= debugger.team.duration:
                    debugger.go_to_time(0.0)
                self.speed, self._started_at, self._from = command.speed, now, debugger.seconds
            case "event":
                self._step_event(backward=command.backward)
            case "statement":
                self._search(command, StatementTarget(command.agent))
            case "hop":
                self._search(command, HopTarget())

    def advance(self, now: float) -> None:
        """Continue playing until `now`; it ends at the end of the recordings."""
        if not self.speed:
            return
        time = self._from + (now - self._started_at) * self.speed
        self._debugger.go_to_time(time)
        if time >= self._debugger.team.duration:
            self.speed = 0.0

    def stop(self, problem: str) -> None:
        """Stop playing, for a reason."""
        self.speed, self.problem = 0.0, problem

    def _search(self, command: ReplayCommand, target: Target) -> None:
        interruptible = _InterruptibleTarget(target, self._is_superseded)
        if not self._debugger.search(interruptible, backward=command.backward):
            self.problem = f"there is no {'earlier' if command.backward else 'later'} {command.go}"

    def _step_event(self, *, backward: bool) -> None:
        """Move to the end of the turn in which the next or last event happened."""
        debugger, order = self._debugger, self._debugger.team.order_of
        position, is_before = order(debugger.place)[:3], debugger.place.step == 0
        for event in self._events_from(debugger.seconds, backward=backward):
            place = self._place_of(event)
            other = order(place)[:3]
            if other < position if backward else other > position or (other == position and is_before):
                debugger.go_to(place)
                return
        self.problem = f"there is no {'earlier' if backward else 'later'} event"
        if not self._events.is_complete:
            self.problem += " among those that are read so far"

    def _events_from(self, seconds: float, *, backward: bool) -> Iterator[IndexedEvent]:
        index = self._events
        if backward:
            stop = index.count_before(seconds + _TOLERANCE)
            return (index.events(n, n + 1)[0] for n in reversed(range(stop)))
        first = index.count_before(seconds - _TOLERANCE)
        return (index.events(n, n + 1)[0] for n in range(first, index.count))

    def _place_of(self, event: IndexedEvent) -> Place:
        team = self._debugger.team
        times = team.times[event.recording]
        turn = min(bisect_left(times, event.time - _TOLERANCE), len(times) - 1)
        return Place(event.recording, turn, _END)


class _InterruptibleTarget:
    """A target whose search can be ended."""

    def __init__(self, target: Target, is_superseded: Callable[[], bool]) -> None:
        self._target, self._is_superseded = target, is_superseded

    @property
    def stops(self) -> frozenset[int] | None:
        """See `Target`."""
        return self._target.stops

    def start(self, moment: Moment) -> None:
        """See `Target`."""
        self._target.start(moment)

    def is_met(self, moment: Moment) -> bool:
        """See `Target`; raises Superseded."""
        if self._is_superseded():
            raise Superseded
        return self._target.is_met(moment)

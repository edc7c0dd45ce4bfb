"""A replay for the page, in a thread of its own: of several commands that wait the newest is executed.

The thread also indexes the recording, in between. The page gets the last published state, so that its event
loop never waits for a replay.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Any

import msgspec

from lfield.errors import LfieldError
from lfield.operator.team_model.team_contents import team_contents
from lfield.operator.team_model.team_state import Curve, TeamState, TrackUpdate
from lfield.operator.web.page_snapshots import ShownPosition
from lfield.replay.debugger.debugger import Debugger
from lfield.replay.debugger.team_timeline import TeamTimeline
from lfield.replay.recording_files import TeamRecording
from lfield.replay.web.guard_index import GuardIndex
from lfield.replay.web.program_view import coordinators_of
from lfield.replay.web.recorded_events import EventIndex
from lfield.replay.web.replay_player import ReplayCommand, ReplayPlayer, Superseded, command_of
from lfield.replay.web.replayed_team import ReplayedTeam

#: Seconds of indexing between two checks for commands, and between two states while it is indexing; between
#: two states while it is playing.
SLICE, INDEX_INTERVAL, PLAY_INTERVAL = 0.02, 0.5, 0.1


class ReplaySession:
    """A source of team states (`TeamStateSource`) with a time that can be moved; a context manager.

    Raises RecordingError if there are no turns.
    """

    def __init__(
        self, name: str, recording: TeamRecording, now: Callable[[], float] = time.monotonic
    ) -> None:
        mission = recording.mission
        team = TeamTimeline([part for each in recording.incarnations for part in each.parts], mission)
        contents = team_contents(name, mission.team, mission)
        self._recording, self._now = recording, now
        self._debugger = Debugger(team)
        self._events = EventIndex(team)
        self._guards = GuardIndex(recording, team, contents, self._events)
        self._steps = self._guards.steps()
        self._team = ReplayedTeam(self._debugger, contents, self._events, self._guards)
        self._player = ReplayPlayer(self._debugger, self._events, self._is_superseded)
        self._changed = threading.Condition()
        self._waiting: ReplayCommand | None = None
        self._is_closed = False
        self._number = 0
        self._has_guards = False
        self._thread: threading.Thread | None = None
        self._published_at = now()
        #: The number of the last requested command, and that of the last one that was executed.
        self._requested_count = self._executed = 0
        self._published: tuple[TeamState, dict[str, Any]] = self._made_state()
        self._place = self._debugger.place

    def __enter__(self) -> ReplaySession:
        self._thread = threading.Thread(target=self._run, name="replay", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._changed:
            self._is_closed = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join()

    # --- for the page, as ReplayControl ---------------------------------------------------------------

    def snapshot(self) -> TeamState:
        """The last published state."""
        return self._published[0]

    def published(self) -> ShownPosition:
        """The last published state with the position."""
        state, position = self._published
        numbers = {"requested": self._requested_count, "executed": self._executed}
        return ShownPosition(state, position["epoch"], msgspec.json.encode({**position, **numbers}))

    def curves(self) -> tuple[Curve, ...]:
        """None: a replay has no plots."""
        return ()

    def tracks(self, after: int) -> TrackUpdate:
        """None: the tracks depend on the time, and are part of the position."""
        return TrackUpdate(0, True, [])

    def request(self, body: object) -> str:
        """Give a command, which replaces one that waits; returns the reason of a refusal, '' if accepted."""
        command = command_of(body)
        if isinstance(command, str):
            return command
        with self._changed:
            self._waiting = command
            self._requested_count += 1
            self._changed.notify()
        return ""

    def _is_superseded(self) -> bool:
        return self._waiting is not None or self._is_closed

    # --- the thread -----------------------------------------------------------------------------------

    @property
    def has_work(self) -> bool:
        """Whether a command waits, or the recording is not indexed yet."""
        return self._waiting is not None or not self._is_indexed

    def advance(self) -> None:
        """Execute the newest command, else play and index; waits if there is no work."""
        command = self._next_command()
        try:
            if command is not None:
                self._execute(command)
            else:
                self._continue()
        except LfieldError as error:
            self._show_problem(str(error))

    def _run(self) -> None:
        while not self._is_closed:
            self.advance()

    def _show_problem(self, problem: str) -> None:
        """Return to the last position that could be shown."""
        self._player.stop(problem)
        self._debugger.go_to(self._place)
        state, position = self._published
        self._published = state, {**position, "speed": 0.0, "problem": problem}
        self._executed = self._number

    def _continue(self) -> None:
        """Play and index."""
        age = self._now() - self._published_at
        if self._player.speed and age >= PLAY_INTERVAL:
            self._player.advance(self._now())
            self._publish()
        if not self._is_indexed:
            self._index_slice()
            if self._is_indexed or age >= INDEX_INTERVAL:
                self._publish()

    def _next_command(self) -> ReplayCommand | None:
        """The newest command. Waits while there is no other work."""
        with self._changed:
            if self._waiting is None and not self._is_closed and self._is_indexed:
                self._changed.wait(PLAY_INTERVAL if self._player.speed else None)
            command, self._waiting = self._waiting, None
            self._number = self._requested_count
            return command

    def _execute(self, command: ReplayCommand) -> None:
        with suppress(Superseded):
            self._player.execute(command, self._now())
            self._publish()
        self._executed = self._number

    @property
    def _is_indexed(self) -> bool:
        return self._has_guards and self._events.is_complete

    def _index_slice(self) -> None:
        """Index a part of the recording."""
        until = time.perf_counter() + SLICE
        while time.perf_counter() < until and not self._is_indexed:
            if not self._has_guards:
                self._has_guards = next(self._steps, self) is self
            else:
                self._events.advance()

    def _publish(self) -> None:
        self._published = self._made_state()
        self._published_at, self._place = self._now(), self._debugger.place

    def _made_state(self) -> tuple[TeamState, dict[str, Any]]:
        debugger, player = self._debugger, self._player
        state = self._team.state()
        tracks = self._guards.tracks.until(debugger.seconds)
        recording = self._recording
        return state, {
            "seconds": debugger.seconds,
            "duration": debugger.team.duration,
            "at": self._team.started_at + debugger.seconds,
            "host": debugger.host,
            "speed": player.speed,
            "progress": self._events.progress if self._has_guards else 0.0,
            "epoch": self._team.epoch,
            "problem": player.problem,
            "missing": list(recording.missing),
            "problems": [*recording.problems, *self._events.problems, *self._guards.problems],
            "coordinators": list(coordinators_of(debugger)),
            "tracks": [{"agent": agent, "points": points} for agent, points in tracks.items()],
        }

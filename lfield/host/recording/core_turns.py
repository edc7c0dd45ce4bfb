"""Runs the turns of a host's core: each at one time, and recorded if there is a recorder.

A core reads the time several times in one turn. The time of the turn may be earlier than the real time by the
length of the turn; the guard checks the deadline of each actuation again, on its own clock.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfield.clock import Clock
from lfield.recording.turn_clocks import TurnClock

if TYPE_CHECKING:
    from lfield.host.core import HostCore
    from lfield.host.effects import Effect
    from lfield.host.inputs import HostInput
    from lfield.host.recording.flight_recorder import FlightRecorder


class CoreTurns(TurnClock):
    """The turns of a core, and the clock of the core: the time of the present turn, or of the last one.

    The core is constructed between `start_turn` and `end_turn`, then attached.
    """

    def __init__(self, clock: Clock) -> None:
        super().__init__(clock)
        self._real = clock.monotonic
        #: Whether a turn is under way, and its wall-clock time, None until it is read.
        self.in_turn = False
        self.wall_time: float | None = None
        self._core: HostCore | None = None
        #: Records the turns; None for no recording.
        self.flight: FlightRecorder | None = None

    def time(self) -> float:
        """Wall-clock seconds since 1970-01-01 UTC: the same value in all of a turn."""
        if not self.in_turn:
            return self._clock.time()
        if self.wall_time is None:
            self.wall_time = self._clock.time()
        return self.wall_time

    def now(self) -> float:
        """The time of the present turn, or the real time between two turns."""
        return self.monotonic() if self.in_turn else self._real()

    def start_turn(self) -> float:
        """A turn begins; returns its time."""
        self.in_turn, self.wall_time = True, None
        return self.latch()

    def end_turn(self) -> None:
        """The turn has ended."""
        self.in_turn = False

    def read_fresh(self) -> float:
        """The real time within a turn; it is recorded."""
        at = self._real()
        if self.flight is not None:
            self.flight.times.append(at)
        return at

    def attach(self, core: HostCore, flight: FlightRecorder | None) -> None:
        """Set the core, and its recorder."""
        self._core, self.flight = core, flight

    def stop_recording(self) -> None:
        """The recorder has failed."""
        self.flight = None

    def run(self, entry: HostInput | None) -> tuple[object, float | None, list[Effect]]:
        """One turn with an input, or with none.

        Returns the answer to the input, the seconds until the next turn (None: after the next input), and the
        effects. `FlightRecorder.complete_turn` follows when the effects are executed.
        """
        core, flight = self._core, self.flight
        assert core is not None
        # As `start_turn` and `end_turn`, which would need two more calls in each turn.
        self._times[0] = at = self._real()
        self.in_turn, self.wall_time = True, None
        try:
            if flight is not None:
                flight.start_turn()
            found = entry.enter(core) if entry is not None else None
            pause, effects = core.run(), core.drain_effects()
            if flight is not None:
                flight.end_turn(at, entry, effects)
        finally:
            self.in_turn = False
        return found, pause, effects

    def apply(self, entry: HostInput) -> object:
        """Pass an input to the core without running it; returns the answer."""
        core, flight = self._core, self.flight
        assert core is not None
        if self.in_turn:
            return entry.enter(core)
        at = self.start_turn()
        try:
            if flight is not None:
                flight.start_turn()
            found = entry.enter(core)
            if flight is not None:
                flight.end_turn(at, entry, [], runs=False)
                flight.complete_turn()
        finally:
            self.end_turn()
        return found


class HostEventClock:
    """The time of the present turn, and the real time between two turns: for events of core and shell."""

    def __init__(self, turns: CoreTurns) -> None:
        self._turns = turns
        self.time = turns.time

    def monotonic(self) -> float:
        """Monotonic seconds."""
        return self._turns.now()

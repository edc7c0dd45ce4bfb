"""The clock of a core: it stands still during a turn, and runs between turns.

A core reads the time several times in one turn. A single time for all of them is an input that can be
recorded and replayed. It may be earlier than the real time by the length of the turn; the guard checks the
deadline of each actuation again, on its own clock.
"""

from __future__ import annotations

from lfield.clock import Clock


class TurnClock:
    """`clock`, latched from `begin_turn` to `end_turn`."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._latched: float | None = None
        #: The wall-clock time of this turn, None until it is read.
        self.wall_time: float | None = None

    def begin_turn(self) -> float:
        """Latch the time; returns it."""
        self._latched = at = self._clock.monotonic()
        self.wall_time = None
        return at

    def end_turn(self) -> None:
        """Let the clock run again."""
        self._latched = None

    @property
    def in_turn(self) -> bool:
        """Whether a turn is under way."""
        return self._latched is not None

    def monotonic(self) -> float:
        """Monotonic seconds: the same value in all of a turn."""
        latched = self._latched
        return self._clock.monotonic() if latched is None else latched

    def time(self) -> float:
        """Wall-clock seconds since 1970-01-01 UTC: the same value in all of a turn."""
        if self._latched is None:
            return self._clock.time()
        if self.wall_time is None:
            self.wall_time = self._clock.time()
        return self.wall_time

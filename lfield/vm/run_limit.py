"""Limits the duration of one run of a machine, and records where time has cut it.

How far a run gets within its time depends on the speed of the computer. A replay must stop at the same
instructions, so it repeats the recorded cuts and does not measure time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from msgspec import Struct

#: The longest run, in seconds, after which the host handles its events.
SECONDS_PER_RUN = 0.005


class RunCuts(Struct, frozen=True, array_like=True):
    """Where time has cut a run: after `turns` turns (0: not cut), and the instructions of turns, by number,
    that an engine ended early."""

    turns: int = 0
    budgets: dict[int, int] = {}

    @property
    def is_empty(self) -> bool:
        """Whether time has cut nothing."""
        return not (self.turns or self.budgets)


#: A run that time has not cut.
UNCUT = RunCuts()


class RunLimit:
    """Ends a run after SECONDS_PER_RUN of `stopwatch`, in seconds."""

    #: Budgets of turns by number, that replace those of the machine.
    budgets: Mapping[int, int] = {}

    def __init__(self, stopwatch: Callable[[], float]) -> None:
        self._stopwatch = stopwatch
        self._until = 0.0
        self._turns = 0
        self._early: dict[int, int] = {}

    def start(self) -> None:
        """A run starts."""
        self._until = self._stopwatch() + SECONDS_PER_RUN
        if self._turns or self._early:
            self._turns, self._early = 0, {}

    def is_over(self, turns: int) -> bool:
        """Whether the run ends after so many turns."""
        if self._stopwatch() <= self._until:
            return False
        self._turns = turns
        return True

    def on_early_end(self, turn: int, executed: int) -> None:
        """The engine has ended a turn, by number, after that many instructions because of its duration."""
        self._early[turn] = executed

    @property
    def cuts(self) -> RunCuts:
        """Where time has cut the last run."""
        return RunCuts(self._turns, self._early) if self._turns or self._early else UNCUT


class ReplayedRunLimit(RunLimit):
    """Repeats the cuts of a recorded run."""

    def __init__(self) -> None:
        super().__init__(float)
        self._cut_after = 0

    def repeat(self, cuts: RunCuts) -> None:
        """Set the cuts of the next run."""
        self._cut_after, self.budgets = cuts.turns, cuts.budgets

    def start(self) -> None:
        """A run starts."""

    def is_over(self, turns: int) -> bool:
        """Whether the recorded run ended after so many turns."""
        return turns == self._cut_after

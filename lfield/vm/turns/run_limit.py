"""Limits the duration of one run of a machine, and records the positions at which time has cut it.

The number of instructions within this time depends on the speed of the computer. A replay must stop at the
same instructions, so it repeats the recorded cuts and does not measure time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from msgspec import Struct

#: The longest run, in seconds, after which the host handles its events.
SECONDS_PER_RUN = 0.005


class RunCuts(Struct, frozen=True, array_like=True):
    """The positions at which time has cut a run: after `turns` turns (0: not cut), and the instructions of
    turns, by number, that an engine ended early.
    """

    turns: int = 0
    budgets: dict[int, int] = {}


#: A run that time has not cut.
UNCUT = RunCuts()


class RunLimit:
    """Ends a run after SECONDS_PER_RUN of `stopwatch`, in seconds."""

    #: The budgets of turns, by number, that replace the budget of the machine.
    budgets: Mapping[int, int] = {}

    def __init__(self, stopwatch: Callable[[], float]) -> None:
        #: The clock, read at the start of a run and after each of its turns.
        self.stopwatch = stopwatch
        self._turns = 0
        self._early: dict[int, int] = {}
        #: Whether `drain_cuts` has cuts to return.
        self.has_cuts = False

    def on_time_over(self, turns: int) -> None:
        """Record that a run ends after `turns` turns because of its duration."""
        self._turns, self.has_cuts = turns, True

    def on_early_end(self, turn: int, executed: int) -> None:
        """Record that the engine has ended a turn, by number, after `executed` instructions because of its
        duration.
        """
        self._early[turn], self.has_cuts = executed, True

    def drain_cuts(self) -> RunCuts:
        """The cuts by time of the runs since the last call."""
        if not self.has_cuts:
            return UNCUT
        found = RunCuts(self._turns, self._early)
        self._turns, self._early, self.has_cuts = 0, {}, False
        return found


class ReplayedRunLimit(RunLimit):
    """Repeats the cuts of a recorded run."""

    def __init__(self) -> None:
        super().__init__(self._read)
        self._reads, self._cut_after = 0, 0

    def repeat(self, cuts: RunCuts) -> None:
        """Set the cuts of the next run."""
        self._reads, self._cut_after, self.budgets = 0, cuts.turns, cuts.budgets

    def _read(self) -> float:
        """The simulated time: infinite after the last turn of the recorded run."""
        self._reads += 1
        return math.inf if self._cut_after and self._reads > self._cut_after else 0.0

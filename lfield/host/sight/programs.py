"""Runs the programs of a host, and measures for how long: that work is no peer's whose message wakes them."""

from __future__ import annotations

from collections.abc import Callable

from lfield.vm.machine import Machine


class Programs:
    """The machine's turns; `stopwatch` may be replaced by one of processing time."""

    def __init__(self, machine: Machine, stopwatch: Callable[[], float]) -> None:
        self._machine, self.stopwatch = machine, stopwatch
        #: For how many seconds programs have run here.
        self.ran = 0.0

    def run(self) -> float | None:
        """As `Machine.run`."""
        began = self.stopwatch()
        pause = self._machine.run()
        self.ran += self.stopwatch() - began
        return pause

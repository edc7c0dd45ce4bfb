"""Processes that measure themselves in rounds, and are stopped while other contenders are measured.

The first process writes a line `CASE = SECONDS...` for each case, then `end`, and pauses for a quarter of a
second, in which it is stopped. A line `error: ...` ends the measurement.
"""

from __future__ import annotations

import resource
import time
from collections.abc import Sequence

from harness.processes import Child, ChildError

Round = dict[str, list[float]]


class Paced:
    """A contender of such processes. Each call is one round; the first round is the warm-up."""

    def __init__(self, children: Sequence[Child]) -> None:
        self._children = children
        self._finish()

    def __call__(self) -> Round:
        """The samples of the next round, by case."""
        for child in self._children:
            child.resume()
        return self._finish()

    def _finish(self) -> Round:
        found = read_round(self._children[0])
        for child in self._children:
            child.pause()
        return found


def whole_run(child: Child, case: str) -> Round:
    """Seconds of a whole command, and its processor time, which depends less on the load of the computer."""
    before = _used_by_children()
    child.wait()
    elapsed = time.perf_counter() - child.started
    return {case: [elapsed], f"{case}, processor": [_used_by_children() - before]}


def _used_by_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def read_round(child: Child) -> Round:
    """Read the samples of a round from a child. Raises ChildError."""
    found: Round = {}
    while (line := child.line()) != "end":
        if line.startswith("error: "):
            raise ChildError(line.removeprefix("error: "))
        case, _, samples = line.partition(" =")
        if samples:
            found.setdefault(case, []).extend(float(word) for word in samples.split())
    return found

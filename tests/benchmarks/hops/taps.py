"""Where the time of a hop goes: methods of lfield that are timed as they are called, in this process.

A tap is entered and left with the method that it is on, and whatever passes meanwhile is its own, but for
what inner taps take. So the stages of one hop add up to all of it. A tap costs a fraction of a microsecond,
half of it inside its stage.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

_now = time.perf_counter

#: The stages that begin where a tap is left.
ENDS, READ = "(the end of the sender's turn)", "read: the kernel, the loop"


@dataclass(frozen=True, slots=True)
class Tap:
    """A method by its owner (a class or a module) and name: the stage that it is, and the one behind it.

    Behind most is the one that was before. `there` is the stage on the host that it came to, where it is
    another: a hop begins where such a tap is entered, and ends where it is left there.
    """

    stage: str
    owner: Any
    name: str
    behind: str = ""
    there: str = ""


class Stages:
    """The stages of the hop that is under way, and those of all that were measured, in seconds."""

    def __init__(self) -> None:
        #: One for each hop.
        self.hops: list[dict[str, float]] = []
        self._hop: dict[str, float] = {}
        self._stage, self._since, self._leaves = "", _now(), False

    def turn(self, stage: str) -> str:
        """From now on time is that of another stage; returns the one before."""
        now, before = _now(), self._stage
        self._hop[before] = self._hop.get(before, 0.0) + now - self._since
        self._stage, self._since = stage, now
        return before

    def tapped(self, tap: Tap, method: Callable[..., Any]) -> Callable[..., Any]:
        """The method, timed."""

        def timed(*args: Any, **named: Any) -> Any:
            ends = bool(tap.there) and self._leaves
            if tap.there and not ends:
                # Perhaps it leaves; if it does not, the next one does.
                self._hop = {}
                self._stage, self._since = "", _now()
            before = self.turn(tap.there if ends else tap.stage)
            try:
                return method(*args, **named)
            finally:
                self._leaves = self._leaves or tap.behind == ENDS
                self.turn(tap.behind or before)
                if ends:
                    self.hops.append(self._hop)
                    self._hop, self._leaves = {}, False

        return timed


@contextmanager
def tapping(stages: Stages, taps: Sequence[Tap]) -> Iterator[None]:
    """Time these methods for as long as this lasts. A name that is none is an AttributeError."""
    methods = [getattr(tap.owner, tap.name) for tap in taps]
    try:
        for tap, method in zip(taps, methods, strict=True):
            setattr(tap.owner, tap.name, stages.tapped(tap, method))
        yield
    finally:
        for tap, method in zip(taps, methods, strict=True):
            setattr(tap.owner, tap.name, method)

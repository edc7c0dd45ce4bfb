"""The distribution of the time of a hop: methods of lfield are timed as they are called, in this process.

A tap covers its method from entry to exit, without the time of inner taps. So the stages of one hop add up
to the whole hop. A tap costs a fraction of a microsecond, half of it inside its stage.
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
    """A method by its owner (a class or a module) and name: its stage, and the stage after it (`behind`).

    By default the stage before the call continues after it. `there` is the stage on the host of arrival, if
    it differs: a hop begins with the entry of such a tap, and ends with its exit on the host of arrival.
    """

    stage: str
    owner: Any
    name: str
    behind: str = ""
    there: str = ""


class Stages:
    """The stages of the current hop, and of all measured hops, in seconds."""

    def __init__(self) -> None:
        #: The stages of each hop.
        self.hops: list[dict[str, float]] = []
        self._hop: dict[str, float] = {}
        self._stage, self._since, self._leaves = "", _now(), False

    def turn(self, stage: str) -> str:
        """Start another stage; returns the previous one."""
        now, before = _now(), self._stage
        self._hop[before] = self._hop.get(before, 0.0) + now - self._since
        self._stage, self._since = stage, now
        return before

    def tapped(self, tap: Tap, method: Callable[..., Any]) -> Callable[..., Any]:
        """The method with timing."""

        def timed(*args: Any, **named: Any) -> Any:
            ends = bool(tap.there) and self._leaves
            if tap.there and not ends:
                # A possible start of a hop: without a departure, the next entry starts it.
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
    """Time these methods within the context. Raises AttributeError for an unknown name."""
    methods = [getattr(tap.owner, tap.name) for tap in taps]
    try:
        for tap, method in zip(taps, methods, strict=True):
            setattr(tap.owner, tap.name, stages.tapped(tap, method))
        yield
    finally:
        for tap, method in zip(taps, methods, strict=True):
            setattr(tap.owner, tap.name, method)

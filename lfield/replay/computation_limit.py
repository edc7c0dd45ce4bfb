"""Finds threads that compute on without a call or a pause, as in an endless loop, and stops them.

A recorded host has waited where another program may compute. A replay would execute such a loop in each
recorded turn, for minutes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from lfield.vm.engine_interface import (
    BUDGET_EXHAUSTED,
    AgentLimits,
    Engine,
    EngineExit,
    Engines,
    EngineWrapper,
    HeapExhausted,
    MonitorBlocked,
    Reading,
)
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import THREAD_ID, W_ID

#: The instructions that a thread of another program may execute without a call or a pause on the reference
#: engine; a faster one may execute more.
MAX_INSTRUCTIONS = 20_000_000
#: The factor by which the longest computation of another program may exceed that of the recorded one.
MAX_FACTOR = 2

#: The agent and the number of a thread.
_Key = tuple[str, int]
#: Called with an agent, its block, the place of the thread, and the time from which on it has computed.
OnOver = Callable[[str, Block, int, float], None]


class ComputationLimit:
    """Measures computations of one host's threads; `now` is the time. `longest` is the longest one.

    `known` is the longest one of the recorded program; without it there is no limit. `on_over` is called for
    each thread that exceeds the limit, once: it executes no instruction after that.
    """

    def __init__(self, now: Callable[[], float], known: int | None, on_over: OnOver) -> None:
        self._now, self._known, self._on_over = now, known, on_over
        self.longest = 0
        #: The instructions of computations that have not ended, and their starts.
        self._spent: dict[_Key, tuple[int, float]] = {}
        self._over: set[_Key] = set()

    def limited(self, engines: Engines) -> Engines:
        """The same engines under this limit."""
        return lambda program, now: _LimitedEngine(engines(program, now), self)

    def is_over(self, key: _Key) -> bool:
        """Whether a thread has exceeded the limit."""
        return key in self._over

    def on_run(self, key: _Key, pace: int, executed: int, leave: EngineExit) -> bool:
        """Count executed instructions of a thread; returns whether it has now exceeded the limit."""
        if not (leave is BUDGET_EXHAUSTED or isinstance(leave, HeapExhausted | MonitorBlocked)):
            self._spent.pop(key, None)
            return False
        spent, since = self._spent.get(key, (0, self._now()))
        self._spent[key] = spent + executed, since
        self.longest = max(self.longest, spent + executed)
        if self._known is None or spent + executed <= max(MAX_INSTRUCTIONS * pace, MAX_FACTOR * self._known):
            return False
        self._over.add(key)
        return True

    def report(self, key: _Key, block: Block, thread: int) -> None:
        """Call `on_over` for a thread at a place of its block."""
        self._on_over(key[0], block, thread, self._spent[key][1])


class _LimitedEngine(EngineWrapper):
    """An engine that does not run threads which have exceeded a limit."""

    def __init__(self, engine: Engine, limit: ComputationLimit) -> None:
        super().__init__(engine)
        self._limit = limit

    def run(
        self,
        block: Block,
        thread: int,
        budget: int,
        limits: AgentLimits,
        readings: Sequence[Reading | None] = (),
    ) -> EngineExit:
        """See `Engine`."""
        key = block.text(block.w[W_ID]), block.w[thread + THREAD_ID]
        if self._limit.is_over(key):
            self.has_read_external, self.unused_budget = False, budget
            return BUDGET_EXHAUSTED
        leave = super().run(block, thread, budget, limits, readings)
        if self._limit.on_run(key, self.pace, budget - self.unused_budget, leave):
            self._limit.report(key, block, thread)
        return leave

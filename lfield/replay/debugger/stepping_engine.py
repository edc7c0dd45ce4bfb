"""Runs threads on the reference engine and stops at statements, without a change of their behaviour."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from lfield.vm.engine_interface import (
    BUDGET_EXHAUSTED,
    HALTED,
    AgentLimits,
    EngineExit,
    EngineWrapper,
    HeapExhausted,
    MonitorBlocked,
    Reading,
)
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import THREAD_ID, THREAD_PC
from lfield.vm.reference import ReferenceEngine

#: Called before an instruction with the block and the place of the thread; both are up to date.
Probe = Callable[[Block, int], None]


class SteppingEngine(EngineWrapper):
    """Calls a probe before each instruction of a set. The probe may end the run by an exception."""

    def __init__(self, engine: ReferenceEngine) -> None:
        super().__init__(engine)
        self._reference = engine
        self._stops: frozenset[int] = frozenset()
        self._probe: Probe | None = None
        #: Block, thread and instruction of the last call of the probe, if that instruction is to be repeated.
        self._repeated: tuple[Block, int, int] | None = None

    def watch(self, stops: frozenset[int], probe: Probe | None) -> None:
        """Call `probe` before these instructions from now on."""
        self._stops, self._probe, self._repeated = stops, probe if stops else None, None

    def run(
        self,
        block: Block,
        thread: int,
        budget: int,
        limits: AgentLimits,
        readings: Sequence[Reading | None] = (),
    ) -> EngineExit:
        """See `Engine`."""
        if self._probe is None:
            return super().run(block, thread, budget, limits, readings)
        return self._run_watched(self._probe, block, thread, budget, limits, readings)

    def _run_watched(
        self,
        probe: Probe,
        block: Block,
        thread: int,
        budget: int,
        limits: AgentLimits,
        readings: Sequence[Reading | None],
    ) -> EngineExit:
        engine, stops, w = self._reference, self._stops, block.w
        self.has_read_external = False
        pc, identity = w[thread + THREAD_PC], w[thread + THREAD_ID]
        if pc in stops and self._repeated != (block, identity, pc):
            probe(block, thread)
        while True:
            leave = engine.run(block, thread, budget, limits, readings, stops)
            self.has_read_external = self.has_read_external or engine.has_read_external
            budget = self.unused_budget = engine.unused_budget
            if leave is not HALTED:
                break
            if not budget:
                # The next run calls the probe.
                return BUDGET_EXHAUSTED
            probe(block, thread)
        is_repeated = isinstance(leave, HeapExhausted | MonitorBlocked) and w[thread + THREAD_PC] in stops
        self._repeated = (block, identity, w[thread + THREAD_PC]) if is_repeated else None
        return leave

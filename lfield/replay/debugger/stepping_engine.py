"""Runs threads on the reference engine and stops at statements, without a change of what they do."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from lfield.vm.engine_interface import (
    BUDGET_EXHAUSTED,
    HALTED,
    AgentLimits,
    EngineExit,
    Group,
    HeapExhausted,
    MonitorBlocked,
    Reading,
)
from lfield.vm.memory.block import Block
from lfield.vm.memory.block_allocator import BlockAllocator
from lfield.vm.memory.layout import THREAD_ID, THREAD_PC, Layouts
from lfield.vm.reference import ReferenceEngine

#: Called before an instruction with the block and the place of the thread; both are up to date.
Probe = Callable[[Block, int], None]


class SteppingEngine:
    """Calls a probe before each instruction of a set. The probe may end the run by an exception."""

    def __init__(self, engine: ReferenceEngine) -> None:
        self._engine = engine
        self.pace = engine.pace
        self.has_read_external, self.unused_budget = False, 0
        self._stops: frozenset[int] = frozenset()
        self._probe: Probe | None = None
        #: Block, thread and instruction of the last call of the probe, if that instruction is to be repeated.
        self._repeated: tuple[Block, int, int] | None = None

    @property
    def space(self) -> BlockAllocator:
        """See `Engine`."""
        return self._engine.space

    @property
    def layouts(self) -> Layouts:
        """See `Engine`."""
        return self._engine.layouts

    @property
    def groups(self) -> Mapping[int, Group]:
        """See `Engine`."""
        return self._engine.groups

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
        engine = self._engine
        if self._probe is None:
            leave = engine.run(block, thread, budget, limits, readings)
            self.has_read_external, self.unused_budget = engine.has_read_external, engine.unused_budget
            return leave
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
        engine, stops, w = self._engine, self._stops, block.w
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

    def complete(self, block: Block, thread: int, word: int) -> None:
        """See `Engine`."""
        self._engine.complete(block, thread, word)

    def throw(self, block: Block, thread: int, thrown: int) -> bool:
        """See `Engine`."""
        return self._engine.throw(block, thread, thrown)

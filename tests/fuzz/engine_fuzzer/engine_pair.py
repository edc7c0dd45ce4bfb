"""A pair of engines: both execute every slice, and all observable results must be the same.

The pair replaces the engine of a machine, so that any program runs on both: exits, the remaining budget, and
the bytes of the block are compared at the end of every slice. Slices also end at random instructions, because
one engine may take over from the other between any two instructions.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from typing import NoReturn

from engine_fuzzer.space_pair import SpacePair
from lfield.bytecode.program import Program
from lfield.vm.engine_interface import (
    BUDGET_EXHAUSTED,
    AgentLimits,
    Engine,
    EngineExit,
    Engines,
    EngineWrapper,
    Reading,
)
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import THREAD_FRAME, THREAD_PC
from lfield.vm.reference import ReferenceEngine as Reference
from quick_code import prepared_once


class TrialOver(Exception):
    """The end of a trial: the number of instructions is reached, or a difference is found."""


class EnginePair(EngineWrapper):
    """The tested engine, and the reference engine on a copy of each block.

    At most `longest` instructions are executed. A difference is added to `differences` as a sentence and ends
    the trial.
    """

    def __init__(
        self,
        program: Program,
        now: Callable[[], float],
        engines: Engines,
        rng: random.Random,
        longest: int,
    ) -> None:
        with prepared_once():
            self.reference = Reference(program, now)
            self.tried: Engine = engines(program, now)
        super().__init__(self.reference)
        self._space = SpacePair(self.tried.space, self._differs)
        self.differences: list[str] = []
        self.done, self.exits = 0, 0
        self._rng, self._longest = rng, longest

    @property
    def space(self) -> SpacePair:
        """The space of the tested engine."""
        return self._space

    def run(
        self,
        block: Block,
        thread: int,
        budget: int,
        limits: AgentLimits,
        readings: Sequence[Reading | None] = (),
    ) -> EngineExit:
        """Run both engines on parts of the budget."""
        left = budget
        while True:
            part = min(left, self._part())
            leave = self._slice(block, thread, part, limits, readings)
            left -= part - self.reference.unused_budget
            if leave != BUDGET_EXHAUSTED or left <= 0:
                self.unused_budget = left
                self.has_read_external = self.reference.has_read_external
                return leave

    def _part(self) -> int:
        """The length of a slice: mostly long, as in the product, sometimes one or two instructions."""
        return self._rng.choice((1, 2, 3, 7, 20, 50, 100, 300, 1000, 1000))

    def _slice(
        self, block: Block, thread: int, budget: int, limits: AgentLimits, readings: Sequence[Reading | None]
    ) -> EngineExit:
        copy = copy_block(block)
        stood = block.w[thread + THREAD_PC]
        expected = self.reference.run(copy, thread, budget, limits, readings)
        what = f"run of {budget} from instruction {stood}"
        leave = self._try(what, lambda: self.tried.run(block, thread, budget, limits, readings))
        self.done += budget - self.reference.unused_budget
        self.exits += 1
        self._same(what, "exit", expected, leave)
        self._same(what, "unused", self.reference.unused_budget, self.tried.unused_budget)
        self._same(what, "asked", self.reference.has_read_external, self.tried.has_read_external)
        self._compare(what, copy, block, thread)
        if self.done >= self._longest:
            raise TrialOver
        return expected

    def complete(self, block: Block, thread: int, value: int) -> None:
        """Complete a group on both engines."""
        copy = copy_block(block)
        self.reference.complete(copy, thread, value)
        self._try("complete", lambda: self.tried.complete(block, thread, value))
        self._compare("complete", copy, block, thread)

    def throw(self, block: Block, thread: int, thrown: int) -> bool:
        """Throw on both engines."""
        copy = copy_block(block)
        handler_found = self.reference.throw(copy, thread, thrown)
        also = self._try("throw", lambda: self.tried.throw(block, thread, thrown))
        self._same("throw", "caught", handler_found, also)
        self._compare("throw", copy, block, thread)
        return handler_found

    # --- differences ----------------------------------------------------------------------------------

    def _try(self, what: str, work: Callable[[], object]) -> object:
        try:
            return work()
        except Exception as error:
            failed = f"{type(error).__name__}: {error}"
        return self._differs(f"{what}: {failed}")

    def _same(self, what: str, of: str, expected: object, found: object) -> None:
        if expected != found:
            self._differs(f"{what}: {of} is {found}, in the reference {expected}")

    def _compare(self, what: str, expected: Block, found: Block, thread: int) -> None:
        """Compare the thread first: its differences are more informative than heap words."""
        for name, word in (("instruction", THREAD_PC), ("frame", THREAD_FRAME)):
            self._same(what, name, expected.w[thread + word], found.w[thread + word])
        self._same(what, "top", expected.top, found.top)
        if expected.data[: 8 * expected.top] == found.data[: 8 * found.top]:
            return
        for place in range(expected.top):
            self._same(what, f"word {place}", hex(expected.w[place]), hex(found.w[place]))

    def _differs(self, how: str) -> NoReturn:
        self.differences.append(how)
        raise TrialOver


def copy_block(block: Block) -> Block:
    """A copy of a block with the same bytes and size."""
    data = bytearray(len(block.data))
    data[: 8 * block.top] = block.data[: 8 * block.top]
    copy = Block(data, block.top, block.limit)
    copy.end = block.end
    return copy

"""Engines for tests: one compares two step by step, one switches between them at random.

The reference engine executes each slice on a copy of the block; the other engine, or both in turns, execute
the slice in place. Then exit, budget and every byte of the block must be equal.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

import pytest

from lfield.bytecode.program import Program
from lfield.vm.engine_interface import (
    BUDGET_EXHAUSTED,
    AgentLimits,
    BudgetExhausted,
    Engine,
    EngineExit,
    EngineWrapper,
    Reading,
)
from lfield.vm.memory.block import Block
from lfield.vm.reference import ReferenceEngine as Reference

#: The reason of a skipped test without wasmtime.
NEEDED = "the engine in WebAssembly needs wasmtime: pip install lfield[wasm]"


class SwitchingEngine(EngineWrapper):
    """Executes parts of each slice on one of two engines at random.

    With `compared` the reference engine repeats every slice on a copy.
    """

    def __init__(self, first: Engine, second: Engine, rng: random.Random, compared: Engine | None) -> None:
        super().__init__(second)
        self._engines, self._rng, self._compared = (first, second), rng, compared
        self.pace = 1
        #: The number of uses of each engine.
        self.given = [0, 0]

    def run(
        self,
        block: Block,
        thread: int,
        budget: int,
        limits: AgentLimits,
        readings: Sequence[Reading | None] = (),
    ) -> EngineExit:
        """Run a slice; raises AssertionError on a difference."""
        before = _copy(block)
        leave = self._parts(block, thread, budget, limits, readings)
        if self._compared is not None:
            exit = self._compared.run(before, thread, budget, limits, readings)
            actual = (leave, self.unused_budget, self.has_read_external, block.top, block.end)
            expected = (
                exit,
                self._compared.unused_budget,
                self._compared.has_read_external,
                before.top,
                before.end,
            )
            assert actual == expected, f"{actual} where the reference engine has {expected}"
            difference = _difference(block, before)
            assert not difference, f"after {leave}: {difference}"
        return leave

    def _parts(
        self, block: Block, thread: int, budget: int, limits: AgentLimits, readings: Sequence[Reading | None]
    ) -> EngineExit:
        self.unused_budget, self.has_read_external = budget, False
        while left := self.unused_budget:
            which = self._rng.randrange(2)
            self.given[which] += 1
            engine = self._engines[which]
            part = left if self._rng.random() < 0.5 else self._rng.randint(1, left)
            leave = engine.run(block, thread, part, limits, readings)
            self.unused_budget -= part - engine.unused_budget
            self.has_read_external = self.has_read_external or engine.has_read_external
            if not isinstance(leave, BudgetExhausted):
                return leave
        return BUDGET_EXHAUSTED

    def complete(self, block: Block, thread: int, value: int) -> None:
        """Complete on a random engine."""
        self._rng.choice(self._engines).complete(block, thread, value)

    def throw(self, block: Block, thread: int, thrown: int) -> bool:
        """Throw on a random engine."""
        return self._rng.choice(self._engines).throw(block, thread, thrown)


def switching(
    wasm: Callable[[Program, Callable[[], float]], Engine], seed: int, compare: bool = True
) -> Callable[[Program, Callable[[], float]], SwitchingEngine]:
    """Creates engines that switch between the reference engine and another one."""

    def make(program: Program, now: Callable[[], float]) -> SwitchingEngine:
        compared = Reference(program, now) if compare else None
        return SwitchingEngine(Reference(program, now), wasm(program, now), random.Random(seed), compared)

    return make


def _copy(block: Block) -> Block:
    return Block(bytearray(block.data), block.top, block.limit)


def _difference(block: Block, other: Block) -> str:
    """The first words that differ, '' for none."""
    if block.image() == other.image():
        return ""
    pairs = enumerate(zip(block.w[: block.top], other.w[: other.top], strict=True))
    found = [f"word {i} is {a:#x}, not {b:#x}" for i, (a, b) in pairs if a != b]
    return "; ".join(found[:8])


def either_engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fixture: VMs use the engine named by its parameter by default."""
    if getattr(request, "param", "") == "both":
        pytest.importorskip("wasmtime", reason=NEEDED)
        from lfield.vm.wasm.wasm_engine import EagerWasmEngine

        monkeypatch.setattr("lfield.vm.machine.ReferenceEngine", switching(EagerWasmEngine, 1))

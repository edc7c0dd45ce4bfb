"""Engines for tests: one that compares two step by step, and one that changes between them at random.

Each slice is done on a copy of the block by the reference engine and in place by the other one, or by both in
turn; then all that can be seen must be the same: the exit, the budget, every byte of the block.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence

import pytest

from lfield.bytecode.program import Program
from lfield.vm.contract import SPENT, Engine, Exit, Group, Limits, Reading, Spent
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import Layouts
from lfield.vm.reference import Engine as Reference

#: Why a test is skipped where there is no wasmtime.
NEEDED = "the engine in WebAssembly needs wasmtime: pip install lfield[wasm]"


class Switching:
    """Gives parts of each slice to one of two engines, as the dice fall.

    `compared` says that the reference engine does it all once more on a copy, and compares.
    """

    def __init__(self, first: Engine, second: Engine, dice: random.Random, compared: Engine | None) -> None:
        self._engines, self._dice, self._compared = (first, second), dice, compared
        self.space, self.pace = second.space, 1
        self._left, self._asked = 0, False
        #: How often each of them was given something to do.
        self.given = [0, 0]

    @property
    def layouts(self) -> Layouts:
        """Those of either engine."""
        return self._engines[0].layouts

    @property
    def groups(self) -> Mapping[int, Group]:
        """Those of either engine."""
        return self._engines[0].groups

    @property
    def asked(self) -> bool:
        """Whether any part of the last slice has read what is beyond the block."""
        return self._asked

    @property
    def unused(self) -> int:
        """What is left of the budget."""
        return self._left

    def run(
        self,
        block: Block,
        thread: int,
        budget: int,
        limits: Limits,
        readings: Sequence[Reading | None] = (),
    ) -> Exit:
        """As every engine; raises AssertionError where they differ."""
        before = _copy(block)
        leave = self._parts(block, thread, budget, limits, readings)
        if self._compared is not None:
            expected = self._compared.run(before, thread, budget, limits, readings)
            seen = (leave, self._left, self._asked, block.top, block.end)
            wanted = (expected, self._compared.unused, self._compared.asked, before.top, before.end)
            assert seen == wanted, f"{seen} where the reference engine has {wanted}"
            difference = _difference(block, before)
            assert not difference, f"after {leave}: {difference}"
        return leave

    def _parts(
        self, block: Block, thread: int, budget: int, limits: Limits, readings: Sequence[Reading | None]
    ) -> Exit:
        self._left, self._asked = budget, False
        while self._left:
            which = self._dice.randrange(2)
            self.given[which] += 1
            engine = self._engines[which]
            part = self._left if self._dice.random() < 0.5 else self._dice.randint(1, self._left)
            leave = engine.run(block, thread, part, limits, readings)
            self._left -= part - engine.unused
            self._asked = self._asked or engine.asked
            if not isinstance(leave, Spent):
                return leave
        return SPENT

    def complete(self, block: Block, thread: int, word: int) -> None:
        """By either of them."""
        self._dice.choice(self._engines).complete(block, thread, word)

    def throw(self, block: Block, thread: int, thrown: int) -> bool:
        """By either of them."""
        return self._dice.choice(self._engines).throw(block, thread, thrown)


def switching(
    wasm: Callable[[Program, Callable[[], float]], Engine], seed: int, compare: bool = True
) -> Callable[[Program, Callable[[], float]], Switching]:
    """Makes engines that switch between the reference engine and another one."""

    def make(program: Program, now: Callable[[], float]) -> Switching:
        compared = Reference(program, now) if compare else None
        return Switching(Reference(program, now), wasm(program, now), random.Random(seed), compared)

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
    """A fixture: machines that are told nothing have the engine that its parameter names."""
    if getattr(request, "param", "") == "both":
        pytest.importorskip("wasmtime", reason=NEEDED)
        from lfield.vm.wasm.engine import Eager

        monkeypatch.setattr("lfield.vm.machine.Engine", switching(Eager, 1))

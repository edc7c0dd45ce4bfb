"""The engine in WebAssembly: runs what it has functions for, and has the reference engine do the rest.

Both work on the same block, and where one stops the other goes on: a thread's place in the block is always
one that the reference engine knows, and at each *point* WebAssembly can take over again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import wasmtime

from lfield.bytecode.program import Program
from lfield.vm.contract import SPENT, STOPPED, Done, Exit, Group, Limits, Reading
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import THREAD_FRAME, THREAD_ID, THREAD_PC, Layouts
from lfield.vm.reference import Engine as Reference
from lfield.vm.wasm.calls import quick, unsigned
from lfield.vm.wasm.code import Cache, code_of
from lfield.vm.wasm.heaps import Heaps
from lfield.vm.wasm.lower.driver import REGISTERS
from lfield.vm.wasm.lower.method import DONE, SHORT
from lfield.vm.wasm.lower.module import low_bytes
from lfield.vm.wasm.lower.table import RUNTIME

_BASE, _TOP, _END, _FRAME, _POINT, _LEFT, _DEPTH, _THREAD, _LONGEST, _TEXT, _PC, _WORD = range(len(REGISTERS))


class Engine:
    """Runs threads of blocks of one program; blocks outside its arena only by the reference engine."""

    pace = 20
    #: So many instructions of a run are the reference engine's, as to enter WebAssembly takes longer: between
    #: two portal calls, and in a portal that hands something on, there are mostly no more.
    first = 12

    def __init__(self, program: Program, now: Callable[[], float], cache: Cache | None = None) -> None:
        self.program = program
        self._reference = Reference(program, now)
        self.space = Heaps(low_bytes(program), cache)
        code = code_of(self._reference.prepared, self.space.reservation, cache)
        #: The number of each instruction where WebAssembly can take over.
        self.points = code.points
        store = self.space.store
        runtime = self.space.functions.instance.exports(store)
        instance = wasmtime.Instance(
            store, code.compiled, [self.space.memory, *(runtime[name] for name in RUNTIME)]
        )
        self._registers = self.space.view(0, 8 * len(REGISTERS)).cast("q")
        self._enter = quick(store, instance, "run", 0)
        self._left = 0
        self._asked = False

    @property
    def layouts(self) -> Layouts:
        """Where references are, for the collector and the copier."""
        return self._reference.layouts

    @property
    def groups(self) -> Mapping[int, Group]:
        """The groups of the program, by their first instruction."""
        return self._reference.groups

    @property
    def asked(self) -> bool:
        """Whether the last run has read what is beyond the block."""
        return self._asked

    @property
    def unused(self) -> int:
        """How many instructions of its budget the last run has not used."""
        return self._left

    def run(
        self,
        block: Block,
        thread: int,
        budget: int,
        limits: Limits,
        readings: Sequence[Reading | None] = (),
    ) -> Exit:
        """As `lfield.vm.reference.Engine.run`."""
        reference, first = self._reference, min(self.first, budget)
        leave = reference.run(block, thread, first, limits, readings)
        self._left, self._asked = budget - first + reference.unused, reference.asked
        return leave if leave is not SPENT else self._go_on(block, thread, limits, readings)

    def _go_on(self, block: Block, thread: int, limits: Limits, readings: Sequence[Reading | None]) -> Exit:
        """Do what is left of the budget, in WebAssembly as far as it can be."""
        reference, points, w = self._reference, self.points, block.w
        base = self.space.base(block.data)
        while self._left > 0:
            point = points.get(w[thread + THREAD_PC], 0) if base >= 0 else 0
            short = False
            if point:
                status = self._resume(block, thread, base, point, limits)
                if status == DONE:
                    return Done(self._registers[_WORD])
                if not self._left:
                    return SPENT
                short = status == SHORT
            stops = points if base >= 0 and not short else None
            leave = reference.run(block, thread, self._left, limits, readings, stops)
            self._left = reference.unused
            self._asked = self._asked or reference.asked
            if leave is not STOPPED:
                return leave
        return SPENT

    def _resume(self, block: Block, thread: int, base: int, point: int, limits: Limits) -> int:
        """Let WebAssembly run from a point on; the block says afterwards where it stands."""
        registers, w = self._registers, block.w
        registers[_BASE] = base
        registers[_TOP] = base + 8 * block.top
        registers[_END] = base + 8 * block.end
        registers[_FRAME] = base + 8 * w[thread + THREAD_FRAME]
        registers[_POINT] = point
        registers[_LEFT] = self._left
        registers[_DEPTH] = limits.call_depth
        registers[_THREAD] = w[thread + THREAD_ID]
        registers[_LONGEST] = limits.array_length
        registers[_TEXT] = limits.string_length
        status = unsigned(self._enter())
        block.top = registers[_TOP] - base >> 3
        w[thread + THREAD_FRAME] = registers[_FRAME] - base >> 3
        w[thread + THREAD_PC] = registers[_PC]
        self._left = registers[_LEFT]
        return status

    def complete(self, block: Block, thread: int, word: int) -> None:
        """Give the group the thread stands at its result; the thread goes on behind it."""
        self._reference.complete(block, thread, word)

    def throw(self, block: Block, thread: int, thrown: int) -> bool:
        """Throw the object at `thrown` where the thread stands; false when nobody catches it."""
        return self._reference.throw(block, thread, thrown)


class Eager(Engine):
    """Enters WebAssembly at once: for whoever tries it."""

    first = 0

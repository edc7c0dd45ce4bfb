"""The engine in WebAssembly: runs what it has functions for, and has the reference engine do the rest.

Both work on the same block, and where one stops the other goes on: a thread's place in the block is always
one that the reference engine knows, and at each *point* WebAssembly can take over again.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Container, Mapping, Sequence

import wasmtime

from lfield.bytecode.program import Program
from lfield.vm.contract import SPENT, STOPPED, Done, Exit, Group, Limits, Outside, Reading
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import FRAME_SLOTS, THREAD_FRAME, THREAD_ID, THREAD_PC, W_ID, Layouts
from lfield.vm.reference import Engine as Reference
from lfield.vm.reference.prepare import Ask
from lfield.vm.wasm.calls import quick, unsigned
from lfield.vm.wasm.code import Cache, code_of
from lfield.vm.wasm.heaps import Heaps
from lfield.vm.wasm.lower.driver import GIVEN, KEPT, REGISTERS, TOLD
from lfield.vm.wasm.lower.method import DONE, SHORT, STEP
from lfield.vm.wasm.lower.module import low_bytes
from lfield.vm.wasm.lower.table import RUNTIME

_give = struct.Struct(f"<{len(GIVEN) + len(KEPT)}q").pack_into
_told = struct.Struct(f"<{len(KEPT) + len(TOLD)}q").unpack_from


#: A run ends after so many seconds: what is rare takes a thousand times as long as what is not. So many
#: instructions at most are the reference engine's before that is looked at.
LONGEST, FEW = 0.002, 2000
#: What making an engine raises where there is no room for one, or wasmtime is of another version.
UNUSABLE = (ImportError, MemoryError, OSError, wasmtime.WasmtimeError)


class Engine:
    """Runs threads of blocks of one program; blocks outside its arena only by the reference engine.

    `note` takes a line where the reference engine runs what is not so rare: a method, an agent.
    """

    pace = 50
    #: So many instructions of a run are the reference engine's, as to enter WebAssembly takes longer: between
    #: two portal calls, and in a portal that hands something on, there are mostly no more.
    first = 12

    def __init__(
        self,
        program: Program,
        now: Callable[[], float],
        cache: Cache | None = None,
        note: Callable[[str], object] = lambda _: None,
    ) -> None:
        self.program = program
        self._note, self._now = note, now
        #: The agents whose blocks have been found elsewhere.
        self._outside: set[str] = set()
        self._reference = Reference(program, now)
        prepared = self._reference.prepared
        self.space = Heaps(low_bytes(program), cache, prepared)
        code = code_of(prepared, self.space.reservation, cache)
        #: The number of each instruction where WebAssembly can take over.
        self.points = code.points
        for method, why in code.left.items():
            note(f"the reference engine runs {method}: {why}")
        store = self.space.store
        runtime = self.space.functions.instance.exports(store)
        instance = wasmtime.Instance(
            store, code.compiled, [self.space.memory, *(runtime[name] for name in RUNTIME)]
        )
        self._asks = prepared.asks
        self._registers = self.space.view(0, 8 * len(REGISTERS))
        self._enter = quick(store, instance, "run", 0)
        #: As of the reference engine.
        self.asked, self.unused = False, 0

    @property
    def layouts(self) -> Layouts:
        """Where references are, for the collector and the copier."""
        return self._reference.layouts

    @property
    def groups(self) -> Mapping[int, Group]:
        """The groups of the program, by their first instruction."""
        return self._reference.groups

    def run(
        self,
        block: Block,
        thread: int,
        budget: int,
        limits: Limits,
        readings: Sequence[Reading | None] = (),
    ) -> Exit:
        """As `lfield.vm.reference.Engine.run`."""
        first = self.first
        if first <= 0 or first >= budget:
            self.asked, self.unused = False, budget
            return self._go_on(block, thread, limits, readings)
        reference = self._reference
        leave = reference.run(block, thread, first, limits, readings)
        self.asked, self.unused = reference.asked, reference.unused + budget - first
        return leave if leave is not SPENT else self._go_on(block, thread, limits, readings)

    def _go_on(self, block: Block, thread: int, limits: Limits, readings: Sequence[Reading | None]) -> Exit:
        """Do what is left of the budget, in WebAssembly as far as it can be, unless it takes long."""
        base, points = self.space.base(block.data), self.points
        if base < 0:
            self._tell(block)
            points = {}
        w, until = block.w, self._now() + LONGEST
        while self.unused > 0:
            status = STEP
            if point := points.get(w[thread + THREAD_PC], 0):
                status, word = self._resume(block, thread, base, point, limits)
                if status == DONE:
                    return Done(word)
                if not self.unused:
                    break
            ask = self._asks.get(w[thread + THREAD_PC])
            if ask is not None and (leave := self._ask(block, thread, ask)) is not None:
                return leave
            leave = self._refer(block, thread, limits, readings, None if status == SHORT else points)
            if leave is not STOPPED and leave is not SPENT:
                return leave
            if self._now() > until:
                break
        return SPENT

    def _tell(self, block: Block) -> None:
        """Say once of an agent that WebAssembly does not run it."""
        identity = block.string(block.w[W_ID]) if block.w[W_ID] else ""
        if identity not in self._outside:
            self._outside.add(identity)
            size = f"{len(block.data) / (1 << 20):.1f} MiB"
            self._note(
                f"{identity or 'an agent'} is run by the reference engine, slowly: "
                f"its block of {size} does not fit the memory of WebAssembly beside the others"
            )

    def _refer(
        self,
        block: Block,
        thread: int,
        limits: Limits,
        readings: Sequence[Reading | None],
        stops: Container[int] | None,
    ) -> Exit:
        """Let the reference engine go on, for a while."""
        reference, budget = self._reference, min(self.unused, FEW)
        leave = reference.run(block, thread, budget, limits, readings, stops or None)
        self.unused += reference.unused - budget
        self.asked = self.asked or reference.asked
        return leave

    def _ask(self, block: Block, thread: int, ask: Ask) -> Exit | None:
        """The exit of a head that leaves; None where the reference engine throws for a null."""
        w = block.w
        slots = w[thread + THREAD_FRAME] + FRAME_SLOTS
        words = [constant if slot is None else w[slots + slot] for slot, constant in ask.arguments]
        for number in ask.checked:
            if not words[number]:
                return None
        self.unused -= 1
        return Outside(ask.op, ask.operand, words)

    def _resume(self, block: Block, thread: int, base: int, point: int, limits: Limits) -> tuple[int, int]:
        """Let WebAssembly run from a point on; the block says afterwards where it stands.

        Returns how it left, and the word of the result where the thread's first method has returned.
        """
        w = block.w
        _give(
            self._registers,
            0,
            base,
            base + 8 * block.end,
            point,
            limits.call_depth,
            limits.array_length,
            limits.string_length,
            w[thread + THREAD_ID],
            base + 8 * block.top,
            base + 8 * w[thread + THREAD_FRAME],
            self.unused,
        )
        status = unsigned(self._enter())
        top, frame, self.unused, w[thread + THREAD_PC], word = _told(self._registers, 8 * len(GIVEN))
        block.top = top - base >> 3
        w[thread + THREAD_FRAME] = frame - base >> 3
        return status, word

    def complete(self, block: Block, thread: int, word: int) -> None:
        """Give the group the thread stands at its result; the thread goes on behind it."""
        self._reference.complete(block, thread, word)

    def throw(self, block: Block, thread: int, thrown: int) -> bool:
        """Throw the object at `thrown` where the thread stands; false when nobody catches it."""
        return self._reference.throw(block, thread, thrown)


class Eager(Engine):
    """Enters WebAssembly at once: for whoever tries it."""

    first = 0

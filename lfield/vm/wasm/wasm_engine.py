"""WebAssembly engine: runs compiled methods, and the reference engine for the rest.

Both work on the same block and alternate: a thread's position in the block is always valid for the reference
engine, and at each *point* WebAssembly can continue.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Container, Mapping, Sequence

import wasmtime

from lfield.bytecode.program import Program
from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.vm.engine_interface import (
    BUDGET_EXHAUSTED,
    HALTED,
    AgentLimits,
    EngineExit,
    Group,
    HostCall,
    Reading,
    ThreadDone,
)
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import FRAME_SLOTS, THREAD_FRAME, THREAD_ID, THREAD_PC, W_ID, Layouts
from lfield.vm.reference import ReferenceEngine as Reference
from lfield.vm.reference.step_compiler import HostCallSite
from lfield.vm.wasm.heap_arena import HeapArena
from lfield.vm.wasm.lowering.instruction_table import RUNTIME
from lfield.vm.wasm.lowering.method_lowering import DONE, SHORT, STEP
from lfield.vm.wasm.lowering.module_lowering import low_bytes
from lfield.vm.wasm.lowering.trampoline import INOUT_REGISTERS, INPUT_REGISTERS, OUTPUT_REGISTERS, REGISTERS
from lfield.vm.wasm.machine_code import CodeCache, code_of
from lfield.vm.wasm.native_calls import bind_function, unsigned

_pack_inputs = struct.Struct(f"<{len(INPUT_REGISTERS) + len(INOUT_REGISTERS)}q").pack_into
_unpack_outputs = struct.Struct(f"<{len(INOUT_REGISTERS) + len(OUTPUT_REGISTERS)}q").unpack_from


#: Seconds after which a run ends: rare operations take a thousand times longer than others. The number of
#: instructions of the reference engine between two checks of this limit.
MAX_STRETCH_SECONDS, MIN_BUDGET = 0.002, 2000
#: The exceptions at creation without enough memory, or with another wasmtime.
UNUSABLE = (ImportError, MemoryError, OSError, wasmtime.WasmtimeError)


class WasmEngine:
    """Runs threads of blocks of one program; blocks outside its arena run only in the reference engine.

    `note` writes a log line when a method or agent runs slowly in the reference engine. `stopwatch` limits
    the duration of a run, by default `now`.
    """

    pace = 50
    #: The instructions of a run that the reference engine executes first, since an entry into WebAssembly
    #: takes longer: the code between two portal calls is mostly shorter.
    first = 12

    def __init__(
        self,
        program: Program,
        now: Callable[[], float],
        cache: CodeCache | None = None,
        note: Callable[[LogLine], object] = lambda _: None,
        stopwatch: Callable[[], float] | None = None,
    ) -> None:
        self.program = program
        self._note, self._stopwatch = note, stopwatch or now
        #: Agents whose blocks were found outside the arena.
        self._outside_arena: set[str] = set()
        self._reference = Reference(program, now)
        prepared = self._reference.prepared
        self.space = HeapArena(low_bytes(program), cache, prepared)
        code = code_of(prepared, self.space.reservation, cache)
        #: The number of each instruction where WebAssembly can continue.
        self.points = code.points
        for method, reason in code.unsupported.items():
            note(log_messages.METHOD_UNCOMPILED.line(method=method, reason=reason))
        store = self.space.store
        runtime = self.space.functions.instance.exports(store)
        instance = wasmtime.Instance(
            store, code.compiled, [self.space.memory, *(runtime[name] for name in RUNTIME)]
        )
        self._host_calls = prepared.host_calls
        self._registers = self.space.view(0, 8 * len(REGISTERS))
        self._enter = bind_function(store, instance, "run", 0)
        #: See `ReferenceEngine`.
        self.has_read_external, self.unused_budget = False, 0

    @property
    def layouts(self) -> Layouts:
        """Positions of references, for the collector and the copier."""
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
        limits: AgentLimits,
        readings: Sequence[Reading | None] = (),
    ) -> EngineExit:
        """As `lfield.vm.reference.ReferenceEngine.run`."""
        first = self.first
        if first <= 0 or first >= budget:
            self.has_read_external, self.unused_budget = False, budget
            return self._continue(block, thread, limits, readings)
        reference = self._reference
        leave = reference.run(block, thread, first, limits, readings)
        self.has_read_external, self.unused_budget = (
            reference.has_read_external,
            reference.unused_budget + budget - first,
        )
        return leave if leave is not BUDGET_EXHAUSTED else self._continue(block, thread, limits, readings)

    def _continue(
        self, block: Block, thread: int, limits: AgentLimits, readings: Sequence[Reading | None]
    ) -> EngineExit:
        """Use the remaining budget, in WebAssembly where possible, within the time slice."""
        base, points = self.space.base(block.data), self.points
        if base < 0:
            self._log_unsupported(block)
            points = {}
        w, until = block.w, self._stopwatch() + MAX_STRETCH_SECONDS
        while self.unused_budget > 0:
            status = STEP
            if point := points.get(w[thread + THREAD_PC], 0):
                status, word = self._resume(block, thread, base, point, limits)
                if status == DONE:
                    return ThreadDone(word)
                if not self.unused_budget:
                    break
            ask = self._host_calls.get(w[thread + THREAD_PC])
            if ask is not None and (leave := self._host_call_exit(block, thread, ask)) is not None:
                return leave
            leave = self._run_reference(block, thread, limits, readings, None if status == SHORT else points)
            if leave is not HALTED and leave is not BUDGET_EXHAUSTED:
                return leave
            if self._stopwatch() > until:
                break
        return BUDGET_EXHAUSTED

    def _log_unsupported(self, block: Block) -> None:
        """Log once per agent that its block is outside the arena, so that WebAssembly cannot run it."""
        identity = block.string(block.w[W_ID]) if block.w[W_ID] else ""
        if identity not in self._outside_arena:
            self._outside_arena.add(identity)
            size = len(block.data) / (1 << 20)
            line = log_messages.BLOCK_OUTSIDE_ARENA.line(agent=identity or "an agent", size=size)
            self._note(line)

    def _run_reference(
        self,
        block: Block,
        thread: int,
        limits: AgentLimits,
        readings: Sequence[Reading | None],
        stops: Container[int] | None,
    ) -> EngineExit:
        """Continue with the reference engine, for at most MIN_BUDGET instructions or until one in `stops`."""
        reference, budget = self._reference, min(self.unused_budget, MIN_BUDGET)
        leave = reference.run(block, thread, budget, limits, readings, stops or None)
        self.unused_budget += reference.unused_budget - budget
        self.has_read_external = self.has_read_external or reference.has_read_external
        return leave

    def _host_call_exit(self, block: Block, thread: int, ask: HostCallSite) -> EngineExit | None:
        """The exit of a host call; None if the reference engine throws for a null."""
        w = block.w
        slots = w[thread + THREAD_FRAME] + FRAME_SLOTS
        words = [constant if slot is None else w[slots + slot] for slot, constant in ask.arguments]
        for number in ask.checked:
            if not words[number]:
                return None
        self.unused_budget -= 1
        return HostCall(ask.op, ask.operand, words)

    def _resume(
        self, block: Block, thread: int, base: int, point: int, limits: AgentLimits
    ) -> tuple[int, int]:
        """Run WebAssembly from a point; the block then has the new position.

        Returns its status, and the result word if the thread's first method has returned.
        """
        w = block.w
        _pack_inputs(
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
            self.unused_budget,
        )
        status = unsigned(self._enter())
        top, frame, self.unused_budget, w[thread + THREAD_PC], word = _unpack_outputs(
            self._registers, 8 * len(INPUT_REGISTERS)
        )
        block.set_top(top - base >> 3)
        w[thread + THREAD_FRAME] = frame - base >> 3
        return status, word

    def complete(self, block: Block, thread: int, word: int) -> None:
        """Pass the result to the thread's group; the thread continues after it."""
        self._reference.complete(block, thread, word)

    def throw(self, block: Block, thread: int, thrown: int) -> bool:
        """Throw the object at `thrown` at the thread's position; false if it is not caught."""
        return self._reference.throw(block, thread, thrown)


class EagerWasmEngine(WasmEngine):
    """Enters WebAssembly at once, for tests."""

    first = 0

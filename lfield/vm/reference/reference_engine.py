"""Interpreter loop: runs a thread of a block until an event that only the machine can handle."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from operator import length_hint

from lfield.bytecode.program import Program
from lfield.vm.engine_interface import (
    HALTED,
    AgentLimits,
    EngineExit,
    Group,
    HeapExhausted,
    Reading,
    Trap,
    UncaughtThrow,
)
from lfield.vm.memory.block import Block, HeapFull
from lfield.vm.memory.block_allocator import HEAP_ALLOCATOR, BlockAllocator
from lfield.vm.memory.layout import (
    FRAME_SLOTS,
    THREAD_FRAME,
    THREAD_PC,
    Layouts,
)
from lfield.vm.memory.word_codec import EXCEPTION_WORDS, new_exception
from lfield.vm.reference.call_steps import LEAVE, Registers
from lfield.vm.reference.step_compiler import PreparedProgram, RaisedObject, prepare
from lfield.vm.reference.unwinder import find_handler, unwind


class ReferenceEngine:
    """Runs threads of blocks of one program in any allocator. Stateless between runs."""

    space: BlockAllocator = HEAP_ALLOCATOR
    pace = 1

    def __init__(self, program: Program, now: Callable[[], float]) -> None:
        self.program = program
        self.prepared: PreparedProgram = prepare(program)
        self._registers = Registers(program, self.prepared.class_names, now)
        #: Whether the last run has read state outside the block, and its unused budget.
        self.has_read_external, self.unused_budget = False, 0

    @property
    def layouts(self) -> Layouts:
        """Positions of references, for the collector and the copier."""
        return self.prepared.layouts

    @property
    def groups(self) -> Mapping[int, Group]:
        """The groups of the program, by their first instruction."""
        return self.prepared.groups

    def run(
        self,
        block: Block,
        thread: int,
        budget: int,
        limits: AgentLimits,
        readings: Sequence[Reading | None] = (),
        stops: Container[int] | None = None,
    ) -> EngineExit:
        """Run the thread at `thread` for at most `budget` instructions; `readings` are by device call.

        With `stops`, at least one instruction is executed; after that, the run ends before an instruction in
        `stops`.

        On return, frame and pc in the block are where the thread will continue: after completed
        instructions, or at the instruction (the group) that could not be executed here.
        """
        m = self._registers
        w = block.w
        m.load(block, thread, budget, limits, readings)
        instructions = m.instructions
        steps = self.prepared.steps
        # The executed instruction, and the next one.
        at = pc = w[thread + THREAD_PC]
        can_continue = True
        while can_continue:
            can_continue = False
            try:
                if stops is not None:
                    at = pc = self._run_steps(m, pc, stops)
                    continue
                for _ in instructions:
                    at = pc
                    pc = steps[at](m)
                    if pc == LEAVE:
                        break
                else:
                    at = pc
            except (Trap, RaisedObject, HeapFull, ValueError, ArithmeticError) as error:
                if stops is None:
                    m.locate(at)
                can_continue = self._recover(m, error)
                at = pc = m.pc
                if can_continue and stops is not None and pc in stops:
                    m.leave(HALTED)
                    can_continue = False
        w[thread + THREAD_FRAME] = m.frame
        w[thread + THREAD_PC] = at
        self.has_read_external, self.unused_budget = m.has_read_external, length_hint(instructions)
        return m.exit

    def _run_steps(self, m: Registers, pc: int, stops: Container[int]) -> int:
        """Run steps until a step exits, a stop is reached, or the budget is used up. Returns the position."""
        steps = self.prepared.steps
        for _ in m.instructions:
            m.locate(pc)
            pc = steps[pc](m)
            if pc == LEAVE:
                return m.pc
            if pc in stops:
                m.leave(HALTED)
                break
        return pc

    def _recover(self, m: Registers, error: Exception) -> bool:
        """Convert an exception of a step to an L exception, and go to its handler; false to exit."""
        match error:
            case HeapFull():
                m.leave(HeapExhausted(error.words))
                return False
            case RaisedObject():
                thrown = error.place
            case Trap():
                thrown = self._new_exception(m.block, error.kind, error.message, error.source)
            case ZeroDivisionError():
                thrown = self._new_exception(m.block, "ArithmeticException", "division by zero")
            case _:
                # A number that does not fit its word in the block.
                thrown = self._new_exception(m.block, "ArithmeticException", "the result does not fit an int")
        if not thrown:
            m.leave(HeapExhausted(EXCEPTION_WORDS))
            return False
        found = find_handler(m.block, self.program, m.frame, m.pc, thrown)
        if found is None:
            m.leave(UncaughtThrow(thrown))
            return False
        frame, handler = found
        unwind(m.block, self.program, m.frame, m.pc, frame, handler, thrown)
        m.enter_handler(frame, handler.target)
        return True

    def _new_exception(self, block: Block, kind: str, message: str, source: str = "") -> int:
        """An exception object of a built-in class, or 0 if the heap is full."""
        try:
            return new_exception(block, self.layouts, kind, message, source)
        except HeapFull:
            return 0

    def complete(self, block: Block, thread: int, word: int) -> None:
        """Pass the result to the thread's group; the thread continues after it."""
        w = block.w
        group = self.prepared.groups[w[thread + THREAD_PC]]
        if group.destination >= 0:
            w[w[thread + THREAD_FRAME] + FRAME_SLOTS + group.destination] = word
        w[thread + THREAD_PC] = group.after

    def throw(self, block: Block, thread: int, thrown: int) -> bool:
        """Throw the object at `thrown` at the thread's position; false if it is not caught."""
        w = block.w
        frame, pc = w[thread + THREAD_FRAME], w[thread + THREAD_PC]
        found = find_handler(block, self.program, frame, pc, thrown)
        if found is None:
            return False
        target, handler = found
        unwind(block, self.program, frame, pc, target, handler, thrown)
        w[thread + THREAD_FRAME] = target
        w[thread + THREAD_PC] = handler.target
        return True

"""The loop: runs a thread of a block until something happens that only the machine can deal with."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from itertools import repeat
from operator import length_hint

from lfield.bytecode.program import Program
from lfield.vm.contract import SPENT, STOPPED, Exit, Group, Limits, NoRoom, Reading, Thrown, Trap
from lfield.vm.memory.block import Block, Full
from lfield.vm.memory.layout import (
    FRAME_SLOTS,
    THREAD_FRAME,
    THREAD_PC,
    Layouts,
)
from lfield.vm.memory.space import SEPARATE, Space
from lfield.vm.memory.values import EXCEPTION_WORDS, new_exception
from lfield.vm.reference.prepare import Prepared, Raised, prepare
from lfield.vm.reference.registers import LEAVE, Registers
from lfield.vm.reference.unwind import find_handler, unwind


class Engine:
    """Runs threads of blocks of one program, wherever their bytes are. Keeps nothing between two runs."""

    space: Space = SEPARATE
    pace = 1

    def __init__(self, program: Program, now: Callable[[], float]) -> None:
        self.program = program
        self.prepared: Prepared = prepare(program)
        self._registers = Registers()
        self._registers.now = now
        self._registers.builtins = program.builtins
        self._registers.others = program.others
        self._registers.class_names = self.prepared.class_names
        #: Whether the last run has read what is beyond the block, and how many instructions of its budget it
        #: has not used.
        self.asked, self.unused = False, 0

    @property
    def layouts(self) -> Layouts:
        """Where references are, for the collector and the copier."""
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
        limits: Limits,
        readings: Sequence[Reading | None] = (),
        stops: Container[int] | None = None,
    ) -> Exit:
        """Run the thread at `thread` for at most `budget` instructions; `readings` are by device call.

        Where there are `stops`, at least one instruction is done, and none at a stop after that.

        On return the thread's frame and pc in the block are where it will go on: behind what is done, or at
        the instruction (the group) that could not be done here.
        """
        m = self._registers
        w = block.w
        m.block, m.w, m.r = block, w, block.r
        m.limits, m.readings, m.asked = limits, readings, False
        m.frame = frame = w[thread + THREAD_FRAME]
        m.slots = frame + FRAME_SLOTS
        m.place = thread
        m.exit = SPENT
        m.instructions = instructions = repeat(None, budget)
        steps = self.prepared.steps
        # The instruction that is done, and the one behind it.
        at = pc = w[thread + THREAD_PC]
        going = True
        while going:
            going = False
            try:
                if stops is not None:
                    at = pc = self._go_to(m, pc, stops)
                    continue
                for _ in instructions:
                    at = pc
                    pc = steps[at](m)
                    if pc == LEAVE:
                        break
                else:
                    at = pc
            except (Trap, Raised, Full, ValueError, ArithmeticError) as error:
                m.pc = at if stops is None else m.pc
                going = self._recover(m, error)
                at = pc = m.pc
                if going and stops is not None and pc in stops:
                    m.exit, going = STOPPED, False
        w[thread + THREAD_FRAME] = m.frame
        w[thread + THREAD_PC] = at
        self.asked, self.unused = m.asked, length_hint(instructions)
        return m.exit

    def _go_to(self, m: Registers, pc: int, stops: Container[int]) -> int:
        """Take steps until one leaves, comes to a stop, or the instructions are used up; where it came to."""
        steps = self.prepared.steps
        for _ in m.instructions:
            m.pc = pc
            pc = steps[pc](m)
            if pc == LEAVE:
                return m.pc
            if pc in stops:
                m.exit = STOPPED
                break
        return pc

    def _recover(self, m: Registers, error: Exception) -> bool:
        """Make an L exception of what a step raised, and go to who catches it; false to leave the engine."""
        match error:
            case Full():
                m.exit = NoRoom(error.words)
                return False
            case Raised():
                thrown = error.place
            case Trap():
                thrown = self._made(m.block, error.kind, error.message, error.source)
            case ZeroDivisionError():
                thrown = self._made(m.block, "ArithmeticException", "division by zero")
            case _:
                # A number that does not fit its word in the block.
                thrown = self._made(m.block, "ArithmeticException", "the result does not fit an int")
        if not thrown:
            m.exit = NoRoom(EXCEPTION_WORDS)
            return False
        found = find_handler(m.block, self.program, m.frame, m.pc, thrown)
        if found is None:
            m.exit = Thrown(thrown)
            return False
        frame, handler = found
        unwind(m.block, self.program, m.frame, m.pc, frame, handler, thrown)
        m.frame, m.slots, m.pc = frame, frame + FRAME_SLOTS, handler.target
        return True

    def _made(self, block: Block, kind: str, message: str, source: str = "") -> int:
        """An exception object of a built-in class, or 0 when there is no room for it."""
        try:
            return new_exception(block, self.layouts, kind, message, source)
        except Full:
            return 0

    def complete(self, block: Block, thread: int, word: int) -> None:
        """Give the group the thread stands at its result; the thread goes on behind it."""
        w = block.w
        group = self.prepared.groups[w[thread + THREAD_PC]]
        if group.destination >= 0:
            w[w[thread + THREAD_FRAME] + FRAME_SLOTS + group.destination] = word
        w[thread + THREAD_PC] = group.after

    def throw(self, block: Block, thread: int, thrown: int) -> bool:
        """Throw the object at `thrown` where the thread stands; false when nobody catches it."""
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

"""The loop: runs a thread of a block until something happens that only the machine can deal with."""

from __future__ import annotations

from lfield.bytecode.program import BUILTIN_CLASSES, MESSAGE, SOURCE, Program
from lfield.vm.block import Block, Full
from lfield.vm.engine.prepare import Group, Prepared, Raised, prepare
from lfield.vm.engine.registers import LEAVE, Registers, Trap
from lfield.vm.engine.unwind import find_handler, unwind
from lfield.vm.exits import SPENT, Exit, NoRoom, Thrown
from lfield.vm.layout import (
    FRAME_SLOTS,
    OBJECT,
    THREAD_FRAME,
    THREAD_ID,
    THREAD_PC,
    Layouts,
)
from lfield.vm.limits import Limits

#: The longest message an exception made by the machine carries, in characters.
MESSAGE_LENGTH = 1000


class Engine:
    """Runs threads of blocks of one program. Keeps nothing between two calls of `run`."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self.prepared: Prepared = prepare(program)
        self._registers = Registers()

    @property
    def layouts(self) -> Layouts:
        """Where references are, for the collector and the copier."""
        return self.prepared.layouts

    def group(self, pc: int) -> Group:
        """The group that begins at an instruction."""
        return self.prepared.groups[pc]

    def run(self, block: Block, thread: int, budget: int, limits: Limits) -> Exit:
        """Run the thread at `thread` for at most `budget` instructions.

        On return the thread's frame and pc in the block are where it will go on: behind what is done, or at
        the instruction (the group) that could not be done here.
        """
        m = self._registers
        m.block, m.limits, m.class_names = block, limits, self.prepared.class_names
        w = m.w = block.w
        m.r = block.r
        m.frame = w[thread + THREAD_FRAME]
        m.slots = m.frame + FRAME_SLOTS
        m.thread = w[thread + THREAD_ID]
        pc = w[thread + THREAD_PC]
        m.exit = SPENT
        steps = self.prepared.steps
        left = budget
        while True:
            try:
                while left > 0:
                    left -= 1
                    at = pc
                    pc = steps[pc](m)
                    if pc == LEAVE:
                        pc = at
                        break
                break
            except Trap as trap:
                thrown = self._made(block, trap.kind, trap.message, trap.source)
            except Raised as raised:
                thrown = raised.place
            except Full as full:
                m.exit, pc = NoRoom(full.words), at
                break
            except (ValueError, OverflowError):
                thrown = self._made(block, "ArithmeticException", "the result does not fit an int")
            except ZeroDivisionError:
                thrown = self._made(block, "ArithmeticException", "division by zero")
            if not thrown:
                m.exit, pc = NoRoom(_EXCEPTION_WORDS), at
                break
            landed = self._land(m, at, thrown)
            if landed is None:
                m.exit, pc = Thrown(thrown), at
                break
            pc = landed
        w[thread + THREAD_FRAME] = m.frame
        w[thread + THREAD_PC] = pc
        return m.exit

    def _land(self, m: Registers, pc: int, thrown: int) -> int | None:
        """Go to who catches the object; None when nobody does."""
        found = find_handler(m.block, self.program, m.frame, pc, thrown)
        if found is None:
            return None
        frame, handler = found
        unwind(m.block, self.program, m.frame, pc, frame, handler, thrown)
        m.frame, m.slots = frame, frame + FRAME_SLOTS
        return handler.target

    def _made(self, block: Block, kind: str, message: str, source: str = "") -> int:
        """An exception object of a built-in class, or 0 when there is no room for it."""
        try:
            return new_exception(block, kind, message, source)
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


_EXCEPTION_WORDS = 16 + MESSAGE_LENGTH // 8


def new_exception(block: Block, kind: str, message: str, source: str = "") -> int:
    """An object of a built-in exception class; raises Full before anything that matters is written."""
    with block.reserve():
        text = block.new_string(message[:MESSAGE_LENGTH])
        about = block.new_string(source)
        place = block.allocate(OBJECT, BUILTIN_CLASSES.index(kind), 4)
    block.w[place + 1 + MESSAGE] = text
    block.w[place + 1 + SOURCE] = about
    return place

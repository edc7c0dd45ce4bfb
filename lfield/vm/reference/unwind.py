"""Finding who catches: walks the frames of a thread, innermost first."""

from __future__ import annotations

from lfield.bytecode.program import Handler, Program
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import FRAME_CALLER, FRAME_RETURN, FRAME_SLOTS, OBJECT
from lfield.vm.reference.calls import release


def find_handler(
    block: Block, program: Program, frame: int, pc: int, thrown: int
) -> tuple[int, Handler] | None:
    """The frame and handler that catch the object at `thrown`, or None. Changes nothing."""
    w = block.w
    head = w[thrown]
    kinds = program.kinds[head >> 8 & 0xFFFFFF if head & 0xFF == OBJECT else 0]
    while frame:
        method = program.core.methods[w[frame] >> 8 & 0xFFFFFF]
        for handler in method.handlers:
            if handler.start <= pc < handler.end and handler.catches in kinds:
                return frame, handler
        # A caller stands behind its call; the call itself is the instruction before.
        pc = w[frame + FRAME_RETURN] - 1
        frame = w[frame + FRAME_CALLER]
    return None


def unwind(
    block: Block, program: Program, frame: int, pc: int, target: int, handler: Handler, thrown: int
) -> None:
    """Leave all frames down to `target`, giving back the monitors they hold, and bind the object."""
    w = block.w
    while frame != target:
        method = program.core.methods[w[frame] >> 8 & 0xFFFFFF]
        if method.synchronized and pc != method.entry:
            release(w)
        pc = w[frame + FRAME_RETURN] - 1
        frame = w[frame + FRAME_CALLER]
    w[target + FRAME_SLOTS + handler.slot] = thrown

"""Where a thread stands, in L lines: for dead agents, for portals that throw, for dumps."""

from __future__ import annotations

from dataclasses import dataclass

from lfield.bytecode.program import BUILTIN_CLASSES, MESSAGE, TRACE, Program
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import FRAME_CALLER, FRAME_RETURN, THREAD_FRAME, THREAD_PC


@dataclass(frozen=True, slots=True)
class Place:
    """One frame of a thread: its place in the block, method, instruction, and the line that made it."""

    frame: int
    method: int
    pc: int
    file: str
    line: int


def stack(block: Block, program: Program, thread: int) -> list[Place]:
    """The frames of the thread at `thread`, innermost first."""
    w = block.w
    frame, pc = w[thread + THREAD_FRAME], w[thread + THREAD_PC]
    places = []
    while frame:
        method = w[frame] >> 8 & 0xFFFFFF
        places.append(Place(frame, method, pc, *program.line(method, pc)))
        pc = w[frame + FRAME_RETURN] - 1
        frame = w[frame + FRAME_CALLER]
    return places


def lines(block: Block, program: Program, thread: int) -> list[str]:
    """`at Server.fib (cs.L:52)` for each frame, innermost first."""
    return [
        f"at {program.method_name(p.method)} ({p.file}:{p.line})"
        if p.line
        else f"at {program.method_name(p.method)}"
        for p in stack(block, program, thread)
    ]


def describe(block: Block, program: Program, thrown: int) -> tuple[str, str, str]:
    """Class name, message and trace of a thrown object ('' where it has none)."""
    record = block.w[thrown] >> 8 & 0xFFFFFF
    name = program.core.classes[record].name
    if record >= len(BUILTIN_CLASSES):
        return name, "", ""
    w = block.w
    return name, block.text(w[thrown + 1 + MESSAGE]), block.text(w[thrown + 1 + TRACE])

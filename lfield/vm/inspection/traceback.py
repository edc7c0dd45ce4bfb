"""Stack traces of threads in L lines, for dead agents, failed portals and dumps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import TypeVar

from msgspec import Struct

from lfield.bytecode.opcodes import BY_NAME
from lfield.bytecode.program import FINALLY, LIBRARY_SOURCE, MESSAGE, TRACE, Program
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import (
    FRAME_CALLER,
    FRAME_RETURN,
    PARKED,
    SLEEPING,
    THREAD_FRAME,
    THREAD_PC,
    THREAD_STATE,
)

#: Maximum frames shown of a deep stack.
INNERMOST, OUTERMOST = 10, 6

_THROW = BY_NAME["throw"].code

Frame = TypeVar("Frame")


class FrameLocation(Struct, frozen=True):
    """One frame of a thread: its position in the block, method, instruction and source line."""

    frame: int
    method: int
    pc: int
    file: str
    line: int


def stack(block: Block, program: Program, thread: int) -> list[FrameLocation]:
    """The frames of the thread at `thread`, innermost first."""
    return list(_frames(block, program, block.w[thread + THREAD_FRAME], block.w[thread + THREAD_PC]))


def innermost(block: Block, program: Program, thread: int) -> FrameLocation | None:
    """The innermost frame of the thread at `thread`, and its operation; None without frames.

    A sleeping or yielding thread is positioned after this operation.
    """
    w = block.w
    pc = w[thread + THREAD_PC] - (w[thread + THREAD_STATE] in (SLEEPING, PARKED))
    return next(_frames(block, program, w[thread + THREAD_FRAME], pc), None)


def _frames(block: Block, program: Program, frame: int, pc: int) -> Iterator[FrameLocation]:
    w = block.w
    while frame:
        method = w[frame] >> 8 & 0xFFFFFF
        yield FrameLocation(frame, method, pc, *program.line(method, pc))
        pc = w[frame + FRAME_RETURN] - 1
        frame = w[frame + FRAME_CALLER]


def lines_down_to(block: Block, program: Program, frame: int, pc: int, last: int, trace: str) -> list[str]:
    """The lines of a trace from a frame at `pc` to the frame at `last`; at most ten."""
    found = list(islice(_frames(block, program, frame, pc), INNERMOST))
    end = next((i for i, place in enumerate(found, 1) if place.frame == last), len(found))
    return [_line(program, place) for place in _earlier_frames(trace, program, _own(found[:end]))]


def lines(block: Block, program: Program, thread: int, trace: str = "") -> list[str]:
    """`at Server.fib (cs.L:52)` for each frame of a trace, innermost first; only both ends of a deep
    stack.
    """
    own = _own(stack(block, program, thread))
    inner, between, outer = split_ends(_earlier_frames(trace, program, own))
    omitted = [f"... {between} more calls ..."] if between else []
    return [*(_line(program, p) for p in inner), *omitted, *(_line(program, p) for p in outer)]


def _own(frames: list[FrameLocation]) -> list[FrameLocation]:
    """The frames without the frames of the library in L, which do not help the author of a program."""
    return [place for place in frames if place.file != LIBRARY_SOURCE]


def _earlier_frames(trace: str, program: Program, frames: list[FrameLocation]) -> list[FrameLocation]:
    """The frames except the innermost, whose `finally` rethrows an exception with a trace to it."""
    recorded = trace.splitlines()[-1:]
    if recorded and frames and _throws_again(program, frames[0]):
        method = recorded[0].split(" (")[0].strip()
        return frames[1:] if method == f"at {program.method_name(frames[0].method)}" else frames
    return frames


def _throws_again(program: Program, place: FrameLocation) -> bool:
    """Whether a frame is at the end of a `finally` entered by an exception."""
    quad, handlers = program.quads[place.pc], program.core.methods[place.method].handlers
    return quad.op == _THROW and any(h.kind == FINALLY and h.slot == quad.a for h in handlers)


def _line(program: Program, place: FrameLocation) -> str:
    where = f" ({place.file}:{place.line})" if place.line else ""
    return f"at {program.method_name(place.method)}{where}"


def split_ends(frames: Sequence[Frame]) -> tuple[Sequence[Frame], int, Sequence[Frame]]:
    """The innermost frames of a stack, the number of omitted ones, and the outermost frames.

    The ends show the entry of a recursion and its steps.
    """
    between = len(frames) - INNERMOST - OUTERMOST
    if between <= 1:
        return frames, 0, ()
    return frames[:INNERMOST], between, frames[-OUTERMOST:]


def describe(block: Block, program: Program, thrown: int) -> tuple[str, str, str]:
    """Class name, message and trace of a thrown object ('' if it has none)."""
    record = block.w[thrown] >> 8 & 0xFFFFFF
    name = program.core.classes[record].name
    if record >= program.builtins:
        return name, "", ""
    w = block.w
    return name, block.text(w[thrown + 1 + MESSAGE]), block.text(w[thrown + 1 + TRACE])

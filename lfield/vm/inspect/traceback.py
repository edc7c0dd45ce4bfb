"""Where a thread stands, in L lines: for dead agents, for portals that throw, for dumps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TypeVar

from lfield.bytecode.opcodes import BY_NAME
from lfield.bytecode.program import FINALLY, MESSAGE, TRACE, Program
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

#: Of a deep stack so many frames are shown.
INNERMOST, OUTERMOST = 10, 6

_THROW = BY_NAME["throw"].code

Frame = TypeVar("Frame")


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
    return list(_frames(block, program, block.w[thread + THREAD_FRAME], block.w[thread + THREAD_PC]))


def innermost(block: Block, program: Program, thread: int) -> Place | None:
    """The innermost frame of the thread at `thread`, and what it does there; None for one that has none.

    Who sleeps or yields stands behind that instruction already.
    """
    w = block.w
    pc = w[thread + THREAD_PC] - (w[thread + THREAD_STATE] in (SLEEPING, PARKED))
    return next(_frames(block, program, w[thread + THREAD_FRAME], pc), None)


def _frames(block: Block, program: Program, frame: int, pc: int) -> Iterator[Place]:
    w = block.w
    while frame:
        method = w[frame] >> 8 & 0xFFFFFF
        yield Place(frame, method, pc, *program.line(method, pc))
        pc = w[frame + FRAME_RETURN] - 1
        frame = w[frame + FRAME_CALLER]


def lines_down_to(block: Block, program: Program, frame: int, pc: int, last: int, trace: str) -> list[str]:
    """The lines behind a trace, from a frame that stands at `pc` to the one at `last`; at most ten."""
    found = list(islice(_frames(block, program, frame, pc), INNERMOST))
    end = next((i for i, place in enumerate(found, 1) if place.frame == last), len(found))
    return [_line(program, place) for place in _behind(trace, program, found[:end])]


def lines(block: Block, program: Program, thread: int, trace: str = "") -> list[str]:
    """`at Server.fib (cs.L:52)` for each frame behind a trace, innermost first; of a deep stack both ends."""
    inner, between, outer = ends(_behind(trace, program, stack(block, program, thread)))
    left_out = [f"... {between} more calls ..."] if between else []
    return [*(_line(program, p) for p in inner), *left_out, *(_line(program, p) for p in outer)]


def _behind(trace: str, program: Program, frames: list[Place]) -> list[Place]:
    """Frames without the innermost, where its `finally` throws again what has a trace down to it."""
    noted = trace.splitlines()[-1:]
    if noted and frames and _throws_again(program, frames[0]):
        method = noted[0].split(" (")[0].strip()
        return frames[1:] if method == f"at {program.method_name(frames[0].method)}" else frames
    return frames


def _throws_again(program: Program, place: Place) -> bool:
    """Whether a frame stands at the end of a `finally` that an exception has led to."""
    quad, handlers = program.quads[place.pc], program.core.methods[place.method].handlers
    return quad.op == _THROW and any(h.kind == FINALLY and h.slot == quad.a for h in handlers)


def _line(program: Program, place: Place) -> str:
    where = f" ({place.file}:{place.line})" if place.line else ""
    return f"at {program.method_name(place.method)}{where}"


def ends(frames: Sequence[Frame]) -> tuple[Sequence[Frame], int, Sequence[Frame]]:
    """The innermost frames of a stack, how many are left out behind them, and the outermost ones.

    The ends tell how a recursion was entered and what it does; a thousand frames between say the same again.
    """
    between = len(frames) - INNERMOST - OUTERMOST
    if between <= 1:
        return frames, 0, ()
    return frames[:INNERMOST], between, frames[-OUTERMOST:]


def describe(block: Block, program: Program, thrown: int) -> tuple[str, str, str]:
    """Class name, message and trace of a thrown object ('' where it has none)."""
    record = block.w[thrown] >> 8 & 0xFFFFFF
    name = program.core.classes[record].name
    if record >= program.builtins:
        return name, "", ""
    w = block.w
    return name, block.text(w[thrown + 1 + MESSAGE]), block.text(w[thrown + 1 + TRACE])

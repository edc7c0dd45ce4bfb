"""Exception unwinding: finds the handler for a thrown object, frame by frame.

A `finally` handles any object, a `catch` handles objects of its class, except inside a `within` whose limit
has expired. Code of a `finally` still runs completely, including its own catches.
"""

from __future__ import annotations

from collections.abc import Iterator

from lfield.bytecode.program import (
    BUILTIN_CLASSES,
    CATCH,
    FINALLY,
    LANDING,
    LIMIT,
    NO_LIMIT,
    TRACE,
    Handler,
    Program,
)
from lfield.vm.inspection.traceback import INNERMOST, lines_down_to
from lfield.vm.memory.block import Block, HeapFull
from lfield.vm.memory.layout import (
    FRAME_CALLER,
    FRAME_RETURN,
    FRAME_SLOTS,
    OBJECT,
    PARKED,
    SLEEPING,
    THREAD_FRAME,
    THREAD_PC,
    THREAD_STATE,
    W_THREADS,
)
from lfield.vm.reference.call_steps import release

_TIME_LIMIT = BUILTIN_CLASSES.index("TimeLimitException")
#: A frame and one of its method's rows.
Row = tuple[int, Handler]


def rows_of(block: Block, program: Program, thread: int) -> Iterator[Row]:
    """Every row around the position of a thread (a record in the block), innermost first."""
    w = block.w
    pc = w[thread + THREAD_PC]
    if w[thread + THREAD_STATE] in (SLEEPING, PARKED):
        # The thread is already positioned after its instruction.
        pc -= 1
    return rows_around(block, program, w[thread + THREAD_FRAME], pc)


def rows_around(block: Block, program: Program, frame: int, pc: int) -> Iterator[Row]:
    """Every row around the instruction at `pc` of a frame and around the calls to it, innermost first."""
    w = block.w
    while frame:
        for handler in program.core.methods[w[frame] >> 8 & 0xFFFFFF].handlers:
            if handler.start <= pc < handler.end:
                yield frame, handler
        # A caller is positioned after its call; the call is the previous instruction.
        pc = w[frame + FRAME_RETURN] - 1
        frame = w[frame + FRAME_CALLER]


def find_handler(block: Block, program: Program, frame: int, pc: int, thrown: int) -> Row | None:
    """The frame and handler for the object at `thrown`, or None. Without side effects."""
    head = block.w[thrown]
    kinds = program.kinds[head >> 8 & 0xFFFFFF if head & 0xFF == OBJECT else 0]
    catch: Row | None = None  # the innermost match, while a limit around it may have expired
    last: Row | None = None  # the handler in that case
    for row in rows_around(block, program, frame, pc):
        handler = row[1]
        if handler.kind == FINALLY and catch is None:
            return row
        if handler.kind == FINALLY:
            last = last or row
        elif handler.kind == CATCH and catch is None and handler.catches in kinds:
            if not program.has_limits:
                return row
            catch = row
        elif handler.kind == LANDING and catch is not None:
            return catch
        elif handler.kind == LIMIT and block.w[row[0] + FRAME_SLOTS + handler.slot] < NO_LIMIT:
            if last is not None:
                return last
            catch = None
    return catch


def stop_limit(block: Block, program: Program) -> int:
    """The word with the end of the limit around the `init` of a coordinator that may be stopped; 0 for none.

    The compiler generates this limit, as the outermost one, if the program stops any coordinator. A stop sets
    the end to the present time: from then on this limit acts like any expired limit.
    """
    if not program.has_stops:
        return 0
    found = 0
    for frame, row in rows_of(block, program, block.w[W_THREADS]):
        if row.kind == LIMIT:
            found = frame + FRAME_SLOTS + row.slot
    return found


def is_of_stop(block: Block, program: Program, thrown: int) -> bool:
    """Whether an exception that a coordinator does not catch is the exception of a stop."""
    word, w = stop_limit(block, program), block.w
    return bool(word) and w[word] < NO_LIMIT and w[thrown] & 0xFFFFFFFF == OBJECT | _TIME_LIMIT << 8


def unwind(
    block: Block, program: Program, frame: int, pc: int, target: int, handler: Handler, thrown: int
) -> None:
    """Leave all frames down to `target`, release their monitors, and bind the object."""
    w = block.w
    if handler.kind == FINALLY:
        _keep_trace(block, program, frame, pc, target, thrown)
    while frame != target:
        method = program.core.methods[w[frame] >> 8 & 0xFFFFFF]
        if method.synchronized and pc != method.entry:
            release(w)
        pc = w[frame + FRAME_RETURN] - 1
        frame = w[frame + FRAME_CALLER]
    w[target + FRAME_SLOTS + handler.slot] = thrown


def _keep_trace(block: Block, program: Program, frame: int, pc: int, target: int, thrown: int) -> None:
    """Record the origin of an object before a `finally` rethrows it, if the heap permits.

    Only built-in exceptions have a field for it.
    """
    w = block.w
    if w[thrown] >> 8 & 0xFFFFFF >= program.builtins:
        return
    trace = block.text(w[thrown + 1 + TRACE])
    before = trace.splitlines()
    if len(before) >= INNERMOST:
        return
    lines = [f"    {line}" for line in lines_down_to(block, program, frame, pc, target, trace)]
    try:
        w[thrown + 1 + TRACE] = block.new_string("\n".join([*before, *lines][:INNERMOST]))
    except HeapFull:
        return

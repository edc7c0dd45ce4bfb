"""Live-variable analysis of slots: dead slots are cleared before a hop, so that only live data is sent.

Backward data flow over the basic blocks of one method, with sets of slots as bits. Computed when a
coordinator first hops from a method, then cached.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise

from lfield.bytecode.opcodes import BY_CODE, BY_NAME
from lfield.bytecode.program import CATCH, FINALLY, Handler, MethodRecord, Program, Quad
from lfield.vm.memory.block import Block
from lfield.vm.memory.data_flow import Edge, Node, solve
from lfield.vm.memory.layout import (
    FRAME_CALLER,
    FRAME_RETURN,
    FRAME_SLOTS,
    THREAD_FRAME,
    THREAD_NEXT,
    THREAD_PC,
    W_THREADS,
    Layouts,
)

#: Maximum instructions of a basic block: liveness inside a block needs a pass over it.
MAX_BLOCK_LENGTH = 64
#: Number of cached positions, the most recently used.
CACHE_SIZE = 256

_ENDS = frozenset(BY_NAME[name].code for name in ("jmp", "return", "rtn", "throw", "noreturn"))
_JUMPS = frozenset(row.code for row in BY_CODE.values() if row.operands and row.operands[0].role == "L")
_ALL = -1


class Liveness:
    """The dead slots at the suspension points of a program's frames."""

    def __init__(self, program: Program, layouts: Layouts) -> None:
        self._program = program
        self._layouts = layouts
        self._methods: dict[int, LiveSlots] = {}
        self._dead = lru_cache(CACHE_SIZE)(self._find_dead)

    def clear_dead(self, block: Block) -> None:
        """Set every reference that no frame will read again to null, except the reference to the object
        itself.
        """
        w = block.w
        thread = w[W_THREADS]
        while thread:
            frame, pc, inside_call = w[thread + THREAD_FRAME], w[thread + THREAD_PC], False
            while frame:
                for offset in self._dead(w[frame] >> 8 & 0xFFFFFF, pc, inside_call):
                    w[frame + offset] = 0
                pc, inside_call = w[frame + FRAME_RETURN], True
                frame = w[frame + FRAME_CALLER]
            thread = w[thread + THREAD_NEXT]

    def _find_dead(self, method: int, pc: int, inside_call: bool) -> tuple[int, ...]:
        """Offsets of the references that a frame of a method will not read again."""
        slots = self._methods.get(method)
        if slots is None:
            slots = self._methods[method] = LiveSlots(self._program, method)
        # If a callee throws, the handlers around its call run.
        live = slots.live_at(pc) | (slots.live_in_handlers(pc - 1) if inside_call else 0)
        references = self._layouts.frame_references[method]
        return tuple(at for at in references if at > FRAME_SLOTS and not live >> at - FRAME_SLOTS & 1)


class LiveSlots:
    """The live slots before every basic block of a method, as bits.

    Nodes are the blocks, and the sets of handlers around them: slots read by their targets are live before
    every covered instruction.
    """

    def __init__(self, program: Program, method: int) -> None:
        self._quads, record = program.quads, program.core.methods[method]
        handlers = [handler for handler in record.handlers if handler.kind in (CATCH, FINALLY)]
        self._starts = _leaders(record, handlers, self._quads)
        self._ends = (*self._starts[1:], record.end)
        around = _enclosing_handlers(self._starts, handlers)
        number = {found: len(self._starts) + i for i, found in enumerate(dict.fromkeys(around))}
        #: The node of the handlers around each block.
        self._handler_nodes = [number[found] for found in around]
        self._sets = solve(
            [self._block(i) for i in range(len(self._starts))]
            + [Node(0, [self._handler(handlers[i]) for i in found]) for found in number]
        )

    def live_at(self, pc: int) -> int:
        """The slots that may be read from an instruction on."""
        block = self._at(pc)
        reads, unwritten = self._through(pc, self._ends[block])
        after = 0
        for successor in self._successors(block):
            after |= self._sets[successor]
        return reads | after & unwritten | self._sets[self._handler_nodes[block]]

    def live_in_handlers(self, pc: int) -> int:
        """The slots that the handlers around an instruction will read."""
        return self._sets[self._handler_nodes[self._at(pc)]]

    def _at(self, pc: int) -> int:
        """The block of an instruction."""
        return bisect_right(self._starts, pc) - 1

    def _block(self, block: int) -> Node:
        reads, unwritten = self._through(self._starts[block], self._ends[block])
        edges = [Edge(successor, unwritten) for successor in self._successors(block)]
        return Node(reads, [*edges, Edge(self._handler_nodes[block], _ALL)])

    def _handler(self, handler: Handler) -> Edge:
        """The node of a handler, which reads the slots of its target, except the slot of the exception."""
        return Edge(self._at(handler.target), ~(1 << handler.slot))

    def _successors(self, block: int) -> list[int]:
        """The blocks that may follow a block."""
        last = self._quads[self._ends[block] - 1]
        following = [self._at(last.a)] if last.op in _JUMPS else []
        return following if last.op in _ENDS else [*following, block + 1]

    def _through(self, start: int, end: int) -> tuple[int, int]:
        """Slots that the instructions read before they write them, and slots that they do not write."""
        reads, unwritten = 0, _ALL
        for pc in range(end - 1, start - 1, -1):
            read, written = _reads_and_writes(self._quads[pc])
            reads = reads & ~written | read
            unwritten &= ~written
        return reads, unwritten


def _reads_and_writes(quad: Quad) -> tuple[int, int]:
    """The slots that an instruction reads, and then writes."""
    read = written = 0
    for operand, value in zip(BY_CODE[quad.op].operands, quad[1:], strict=False):
        if operand.role == "D":
            written |= 1 << value
        elif operand.role in ("S", "V") and value >= 0:
            read |= 1 << value
    return read, written


def _leaders(record: MethodRecord, handlers: Sequence[Handler], quads: Sequence[Quad]) -> list[int]:
    """Starts of the basic blocks of a method: no jump leads into a block, no handler starts or ends inside
    one.
    """
    found = {record.entry, record.end}
    for handler in handlers:
        found |= {handler.start, handler.end, handler.target}
    for pc in range(record.entry, record.end):
        if quads[pc].op in _JUMPS:
            found.add(quads[pc].a)
        if quads[pc].op in _JUMPS or quads[pc].op in _ENDS:
            found.add(pc + 1)
    return [pc for start, end in pairwise(sorted(found)) for pc in range(start, end, MAX_BLOCK_LENGTH)]


def _enclosing_handlers(starts: Sequence[int], handlers: Sequence[Handler]) -> list[tuple[int, ...]]:
    """The handlers around each block."""
    bounds: dict[int, list[int]] = {}
    for i, handler in enumerate(handlers):
        bounds.setdefault(handler.start, []).append(i)
        bounds.setdefault(handler.end, []).append(i)
    found: list[tuple[int, ...]] = []
    enclosing: tuple[int, ...] = ()
    for start in starts:
        if start in bounds:
            enclosing = tuple(sorted(set(enclosing).symmetric_difference(bounds[start])))
        found.append(enclosing)
    return found

"""Which slots a frame will still read: what it will not is cleared before a hop, so only live data travels.

The classic backward data flow over one method, sets of slots as bits of an int. Computed for the methods a
coordinator stands in when it first hops from them, then kept.
"""

from __future__ import annotations

from lfield.bytecode.opcodes import BY_CODE, BY_NAME
from lfield.bytecode.program import CATCH, FINALLY, MethodRecord, Program
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import FRAME_CALLER, FRAME_RETURN, FRAME_SLOTS, THREAD_FRAME, THREAD_PC, Layouts
from lfield.vm.memory.threads import threads

_ENDS = frozenset(BY_NAME[name].code for name in ("jmp", "return", "rtn", "throw", "noreturn"))


class Liveness:
    """The live slots at every instruction of a program, method by method."""

    def __init__(self, program: Program, layouts: Layouts) -> None:
        self.program = program
        self.layouts = layouts
        self._by_method: dict[int, list[int]] = {}

    def clear_dead(self, block: Block) -> None:
        """Set every reference that no frame of the block will read again to null, but the object's own."""
        w = block.w
        for thread in threads(block):
            frame, pc, inside_call = w[thread + THREAD_FRAME], w[thread + THREAD_PC], False
            while frame:
                live = self._live(w[frame] >> 8 & 0xFFFFFF, pc, inside_call)
                for offset in self.layouts.references(w[frame]):
                    slot = offset - FRAME_SLOTS
                    if slot > 0 and not live >> slot & 1:
                        w[frame + offset] = 0
                pc, inside_call = w[frame + FRAME_RETURN], True
                frame = w[frame + FRAME_CALLER]

    def _live(self, method: int, pc: int, inside_call: bool) -> int:
        record = self.program.core.methods[method]
        sets = self._by_method.get(method)
        if sets is None:
            sets = self._by_method[method] = self._solve(record)
        live = sets[pc - record.entry]
        # A callee may also throw: then the handlers around its call go on.
        return live | self._caught(record, sets, pc - 1) if inside_call else live

    def _caught(self, record: MethodRecord, sets: list[int], pc: int) -> int:
        """What the handlers around an instruction will read."""
        live = 0
        for handler in record.handlers:
            if handler.start <= pc < handler.end and handler.kind in (CATCH, FINALLY):
                live |= sets[handler.target - record.entry] & ~(1 << handler.slot)
        return live

    def _solve(self, record: MethodRecord) -> list[int]:
        sets = [0] * (record.end - record.entry + 1)
        changed = True
        while changed:
            changed = False
            for pc in range(record.end - 1, record.entry - 1, -1):
                live = self._before(record, sets, pc)
                if live != sets[pc - record.entry]:
                    sets[pc - record.entry] = live
                    changed = True
        return sets

    def _before(self, record: MethodRecord, sets: list[int], pc: int) -> int:
        quad = self.program.quads[pc]
        row = BY_CODE[quad.op]
        live = 0 if quad.op in _ENDS else sets[pc + 1 - record.entry]
        reads = 0
        for operand, value in zip(row.operands, quad[1:], strict=False):
            if operand.role == "D":
                live &= ~(1 << value)
            elif operand.role in ("S", "V") and value >= 0:
                reads |= 1 << value
            elif operand.role == "L":
                live |= sets[value - record.entry]
        return live | reads | self._caught(record, sets, pc)

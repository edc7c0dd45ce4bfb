"""Lookup tables of the trampoline: continuation of each call, and handlers. They are at the start of the
memory.

    RETURNS   by instruction after a call: its point (0: none), offset of the result in the frame (0: none)
    METHODS   by method: start and end of its handler rows, its entry, whether it is synchronized
    ROWS      by handler: start, end, column, the point of its target, offset of the exception in the frame
    TAKES     by class and column: whether an object of the class is caught

All entries are 32-bit numbers, those of the last table bytes. The column of a handler is the column of its
class, or ANYTHING for a `finally`, which the reference engine must run, or NOTHING.
"""

from __future__ import annotations

import struct

from lfield.bytecode.program import CATCH, FINALLY, Program
from lfield.vm.memory.layout import FRAME_SLOTS
from lfield.vm.reference.step_compiler import PreparedProgram

RETURN, METHOD, ROW = 8, 16, 20
#: Handler types other than columns.
ANYTHING, NOTHING = -1, -2


class LookupTables:
    """Addresses and sizes of a program's tables; `columns` are the caught classes."""

    def __init__(self, program: Program, start: int) -> None:
        core = program.core
        handlers = [handler for method in core.methods for handler in method.handlers]
        self._program = program
        self.columns = sorted({handler.catches for handler in handlers if handler.kind == CATCH})
        self.returns = start
        self.methods = self.returns + RETURN * (len(program.quads) + 1)
        self.rows = self.methods + METHOD * len(core.methods)
        self.catches = self.rows + ROW * len(handlers)
        self.end = self.catches + len(core.classes) * len(self.columns)

    def data(self, prepared: PreparedProgram, points: dict[int, int]) -> bytes:
        """The bytes of all tables."""
        caught = bytes(catches in kinds for kinds in self._program.kinds for catches in self.columns)
        return self._returns(prepared, points) + self._methods() + self._rows(points) + caught

    def _returns(self, prepared: PreparedProgram, points: dict[int, int]) -> bytes:
        rows = [(0, 0)] * (len(self._program.quads) + 1)
        for group in prepared.groups.values():
            return_pc = group.after - (group.destination >= 0)
            into = 8 * (FRAME_SLOTS + group.destination) if group.destination >= 0 else 0
            rows[return_pc] = (points.get(group.after, 0), into)
        return b"".join(struct.pack("<2i", *row) for row in rows)

    def _methods(self) -> bytes:
        rows = []
        at = self.rows
        for method in self._program.core.methods:
            end = at + ROW * len(method.handlers)
            rows.append(struct.pack("<4i", at, end, method.entry, method.synchronized))
            at = end
        return b"".join(rows)

    def _rows(self, points: dict[int, int]) -> bytes:
        rows = []
        for method in self._program.core.methods:
            for h in method.handlers:
                catches = NOTHING
                if h.kind == FINALLY:
                    catches = ANYTHING
                elif h.kind == CATCH:
                    catches = self.columns.index(h.catches)
                slot = 8 * (FRAME_SLOTS + h.slot)
                rows.append(struct.pack("<5i", h.start, h.end, catches, points.get(h.target, 0), slot))
        return b"".join(rows)

"""What the driver looks up: what is behind each call, and who catches what. Laid into the memory's beginning.

    RETURNS   by instruction behind a call: its point (0: none), where in the frame a result goes (0: none)
    METHODS   by method: where its rows of handlers begin and end, its entry, whether it is synchronized
    ROWS      by handler: start, end, what it takes, the point of its target, where in the frame that goes
    TAKES     by class and column: whether an object of the class is taken

All are 32-bit numbers, the last one bytes. What a handler takes is a column, FINALLY for one that the
reference engine must run, or nothing.
"""

from __future__ import annotations

import struct

from lfield.bytecode.program import CATCH, FINALLY, Program
from lfield.vm.memory.layout import FRAME_SLOTS
from lfield.vm.reference.prepare import Prepared

RETURN, METHOD, ROW = 8, 16, 20
#: What handlers take besides columns.
ANYTHING, NOTHING = -1, -2


class Tables:
    """Where each table of a program is, and how many bytes they have; `columns` are the classes caught."""

    def __init__(self, program: Program, start: int) -> None:
        core = program.core
        handlers = [handler for method in core.methods for handler in method.handlers]
        self._program = program
        self.columns = sorted({handler.catches for handler in handlers if handler.kind == CATCH})
        self.returns = start
        self.methods = self.returns + RETURN * (len(program.quads) + 1)
        self.rows = self.methods + METHOD * len(core.methods)
        self.takes = self.rows + ROW * len(handlers)
        self.end = self.takes + len(core.classes) * len(self.columns)

    def data(self, prepared: Prepared, points: dict[int, int]) -> bytes:
        """All of them."""
        takes = bytes(catches in kinds for kinds in self._program.kinds for catches in self.columns)
        return self._returns(prepared, points) + self._methods() + self._rows(points) + takes

    def _returns(self, prepared: Prepared, points: dict[int, int]) -> bytes:
        rows = [(0, 0)] * (len(self._program.quads) + 1)
        for group in prepared.groups.values():
            back = group.after - (group.destination >= 0)
            into = 8 * (FRAME_SLOTS + group.destination) if group.destination >= 0 else 0
            rows[back] = (points.get(group.after, 0), into)
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
                takes = NOTHING
                if h.kind == FINALLY:
                    takes = ANYTHING
                elif h.kind == CATCH:
                    takes = self.columns.index(h.catches)
                slot = 8 * (FRAME_SLOTS + h.slot)
                rows.append(struct.pack("<5i", h.start, h.end, takes, points.get(h.target, 0), slot))
        return b"".join(rows)

"""Slots of one activation record: the object, parameters, locals, temporaries.

A slot has one type for the whole method, so the machine always knows which words are references.
A temporary is reused as soon as its value is consumed. A local gets the slot of an earlier local of
the same name and type whose scope has ended (`int i` in consecutive loops), so every named slot has one
name, which a debugger can show.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from lfield.lang.tree import Local


class Slots:
    """The slots of a method under construction. `types` and `names` go into its records."""

    def __init__(self, object_type: int) -> None:
        self.types = [object_type]
        self.names = [(0, "this")]
        self._of_local: dict[Local, int] = {}
        self._scopes: list[list[tuple[str, int]]] = []
        self._released: dict[tuple[str, int], list[int]] = {}
        self._free: dict[int, list[int]] = {}
        self._temporaries: set[int] = set()

    def of(self, local: Local) -> int:
        """The slot of a declared local."""
        return self._of_local[local]

    def parameter(self, local: Local, kind: int) -> int:
        """The next parameter's slot."""
        slot = self._named(local, kind)
        self._of_local[local] = slot
        return slot

    def declare(self, local: Local, kind: int) -> tuple[int, bool]:
        """A slot for a local in the current scope, and whether an earlier local may have written to it."""
        released = self._released.get((local.name, kind))
        used = bool(released)
        slot = released.pop() if released else self._named(local, kind)
        self._of_local[local] = slot
        self._scopes[-1].append((local.name, slot))
        return slot, used

    @contextmanager
    def scope(self) -> Iterator[None]:
        """The slots of locals that are declared inside are reusable after it."""
        self._scopes.append([])
        yield
        for name, slot in reversed(self._scopes.pop()):
            self._released.setdefault((name, self.types[slot]), []).append(slot)

    def temporary(self, kind: int) -> int:
        """A slot for an intermediate value; `release` frees it."""
        free = self._free.get(kind)
        if free:
            return free.pop()
        slot = self._new(kind)
        self._temporaries.add(slot)
        return slot

    def release(self, *operands: int) -> None:
        """Mark the values of these operands as consumed; only temporaries become free."""
        for operand in operands:
            if operand in self._temporaries:
                self._free.setdefault(self.types[operand], []).append(operand)

    def _named(self, local: Local, kind: int) -> int:
        slot = self._new(kind)
        if local.name:
            self.names.append((slot, local.name))
        return slot

    def _new(self, kind: int) -> int:
        self.types.append(kind)
        return len(self.types) - 1

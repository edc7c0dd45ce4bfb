"""The space of the engine that is tried: what it does with heaps is done in Python too, and compared."""

from __future__ import annotations

from collections.abc import Callable

from lfield.vm.memory.block import Block, Full
from lfield.vm.memory.collector import compact
from lfield.vm.memory.copier import deep_copy
from lfield.vm.memory.layout import Layouts
from lfield.vm.memory.shapes import Shapes, Stances
from lfield.vm.memory.space import Buffer, Space, Walked


class TwinSpace:
    """Gives what the other space gives; `differs` is told, in a sentence, what Python has otherwise."""

    def __init__(self, tried: Space, differs: Callable[[str], object]) -> None:
        self._tried, self._differs = tried, differs

    def room(self, size: int) -> Buffer:
        """As of the space that is tried, with bytes that nobody may rely on."""
        data = self._tried.room(size)
        memoryview(data)[:] = b"\xa5" * size
        return data

    def sized(self, data: Buffer, size: int) -> Buffer:
        """As of the space that is tried."""
        return self._tried.sized(data, size)

    def collected(self, source: Buffer, target: Buffer, layouts: Layouts) -> int:
        """Both collect."""
        copy = _block(source, len(source) // 8, len(source) // 8)
        top = self._tried.collected(source, target, layouts)
        if top:
            compact(copy, layouts)
            self._same("collected", copy, target, top)
        return top

    def copied(
        self,
        source: Buffer,
        used: int,
        roots: list[int],
        target: Buffer,
        top: int,
        end: int,
        layouts: Layouts,
    ) -> tuple[list[int], int] | None:
        """Both copy."""
        old, copy = _block(source, used, used), _block(target, top, end)
        found = self._tried.copied(source, used, roots, target, top, end, layouts)
        if found is None:
            return None
        copies, reached = found
        try:
            expected = deep_copy(old, roots, copy, layouts)
        except Full as full:
            if reached != -full.words:
                self._differs(f"copied: it needs {-reached} words, in the reference {full.words}")
            return found
        if copies != expected:
            self._differs(f"copied: to {copies}, in the reference to {expected}")
        self._same("copied", copy, target, reached)
        return found

    def walked(self, data: Buffer, heap: int, top: int, shapes: Shapes) -> Walked | None:
        """As of the space that is tried."""
        return self._tried.walked(data, heap, top, shapes)

    def travels(self, data: Buffer, top: int, stances: Stances) -> bool:
        """As of the space that is tried."""
        return self._tried.travels(data, top, stances)

    def _same(self, what: str, expected: Block, found: Buffer, top: int) -> None:
        if top != expected.top:
            self._differs(f"{what}: the top is {top}, in the reference {expected.top}")
        words = memoryview(found)[: 8 * top].cast("q")
        for place, (word, wanted) in enumerate(zip(words, expected.w, strict=False)):
            if word != wanted:
                self._differs(f"{what}: word {place} is {word:#x}, in the reference {wanted:#x}")
                return


def _block(data: Buffer, top: int, end: int) -> Block:
    """A block of its own with these bytes."""
    block = Block(bytearray(data), top, end)
    block.end = end
    return block

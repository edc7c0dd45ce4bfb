"""The space of the tested engine: its heap operations are repeated in Python, and compared."""

from __future__ import annotations

from collections.abc import Callable

from lfield.vm.memory.block import Block, HeapFull
from lfield.vm.memory.block_allocator import BlockAllocator, Buffer, VerifiedHeap
from lfield.vm.memory.collector import compact
from lfield.vm.memory.copier import deep_copy
from lfield.vm.memory.heap_schema import HeapSchema, SuspensionPoints
from lfield.vm.memory.layout import Layouts


class SpacePair:
    """Returns the results of the tested space; `differs` receives a sentence for each difference."""

    def __init__(self, tried: BlockAllocator, differs: Callable[[str], object]) -> None:
        self._tried, self._differs = tried, differs

    @property
    def is_native(self) -> bool:
        """True if the tested engine implements heap operations."""
        return self._tried.is_native

    def allocate(self, size: int) -> Buffer:
        """Allocate in the tested space, and overwrite the new bytes, which have no defined values."""
        data = self._tried.allocate(size)
        memoryview(data)[:] = b"\xa5" * size
        return data

    def resize(self, data: Buffer, size: int) -> Buffer:
        """Resize in the tested space."""
        return self._tried.resize(data, size)

    def collect(self, source: Buffer, target: Buffer, layouts: Layouts) -> int:
        """Collect in both spaces."""
        copy = _block(source, len(source) // 8, len(source) // 8)
        top = self._tried.collect(source, target, layouts)
        if top:
            compact(copy, layouts)
            self._same("collected", copy, target, top)
        return top

    def copy(
        self,
        source: Buffer,
        used: int,
        roots: list[int],
        target: Buffer,
        top: int,
        end: int,
        layouts: Layouts,
    ) -> tuple[list[int], int] | None:
        """Copy in both spaces."""
        old, copy = _block(source, used, used), _block(target, top, end)
        found = self._tried.copy(source, used, roots, target, top, end, layouts)
        if found is None:
            return None
        copies, reached = found
        try:
            expected = deep_copy(old, roots, copy, layouts)
        except HeapFull as full:
            if reached != -full.words:
                self._differs(f"copied: it needs {-reached} words, in the reference {full.words}")
            return found
        if copies != expected:
            self._differs(f"copied: to {copies}, in the reference to {expected}")
        self._same("copied", copy, target, reached)
        return found

    def verify_heap(self, data: Buffer, heap: int, top: int, shapes: HeapSchema) -> VerifiedHeap | None:
        """Verify in the tested space."""
        return self._tried.verify_heap(data, heap, top, shapes)

    def can_migrate(self, data: Buffer, top: int, stances: SuspensionPoints) -> bool:
        """Return the answer of the tested space."""
        return self._tried.can_migrate(data, top, stances)

    def _same(self, what: str, expected: Block, found: Buffer, top: int) -> None:
        if top != expected.top:
            self._differs(f"{what}: the top is {top}, in the reference {expected.top}")
        words = memoryview(found)[: 8 * top].cast("q")
        for place, (word, reference) in enumerate(zip(words, expected.w, strict=False)):
            if word != reference:
                self._differs(f"{what}: word {place} is {word:#x}, in the reference {reference:#x}")
                return


def _block(data: Buffer, top: int, end: int) -> Block:
    """A new block with these bytes."""
    block = Block(bytearray(data), top, end)
    block.end = end
    return block

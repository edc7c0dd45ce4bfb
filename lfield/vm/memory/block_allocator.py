"""Allocators of block bytes: separate byte arrays, or regions of a memory visible to an engine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol

from lfield.vm.memory.heap_schema import HeapSchema, SuspensionPoints
from lfield.vm.memory.layout import Layouts

#: Writable bytes: a `bytearray`, or a view of a memory.
Buffer = bytearray | memoryview
#: Positions of objects, each with the lower half of its header, and the places of tickets, in order.
VerifiedHeap = tuple[Mapping[int, int], list[int]]


class BlockAllocator(Protocol):
    """Allocates the bytes of blocks, and frees them when no view is left.

    Native allocators may execute heap operations themselves, with results identical to the Python code:
    otherwise `collect`, `copy`, `verify_heap` and `can_migrate` decline.
    """

    @property
    def is_native(self) -> bool:
        """Whether the allocator may execute heap operations itself."""

    def allocate(self, size: int, /) -> Buffer:
        """`size` uninitialised bytes (8 for each word)."""

    def resize(self, data: Buffer, size: int) -> Buffer:
        """The bytes of `data` with another size; `data` must not be used any more.

        Added bytes are uninitialised.
        """

    def collect(self, source: Buffer, target: Buffer, layouts: Layouts) -> int:
        """Copy live data (`lfield.vm.memory.collector`) after the header in the target.

        Returns the new top in words; 0, without effect, if the allocator cannot collect.
        """

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
        """Copy all objects reachable from the roots (`lfield.vm.memory.copier`) to `top`; the source has
        `used` words.

        Returns the references to the copies and the new top; if the space before `end` is too small, the top
        is the negated number of words needed. None if the allocator cannot copy.
        """

    def verify_heap(self, data: Buffer, heap: int, top: int, schema: HeapSchema) -> VerifiedHeap | None:
        """The objects between two words, if sizes, texts, proxies and references are valid; None if the
        allocator cannot decide (`lfield.vm.memory.block_verifier`).

        The result is valid until the next call.
        """

    def can_migrate(self, data: Buffer, top: int, suspension_points: SuspensionPoints) -> bool:
        """Whether a migrating coordinator's block of `top` words is certainly valid.

        The caller has checked magic, version and program. False if the allocator cannot decide.
        """


class HeapAllocator:
    """Separate bytes for each block, for engines without a memory of their own."""

    is_native = False

    def __init__(self) -> None:
        self.allocate: Callable[[int], bytearray] = bytearray

    def resize(self, data: Buffer, size: int) -> Buffer:
        if not isinstance(data, bytearray):
            copy = bytearray(size)
            copied = min(size, len(data))
            copy[:copied] = data[:copied]
            return copy
        data.extend(bytes(max(0, size - len(data))))
        del data[size:]
        return data

    def collect(self, source: Buffer, target: Buffer, layouts: Layouts) -> int:
        return 0

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
        return None

    def verify_heap(self, data: Buffer, heap: int, top: int, schema: HeapSchema) -> VerifiedHeap | None:
        return None

    def can_migrate(self, data: Buffer, top: int, suspension_points: SuspensionPoints) -> bool:
        return False


HEAP_ALLOCATOR = HeapAllocator()

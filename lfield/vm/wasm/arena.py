"""Region allocator: one WebAssembly memory with the blocks of all agents of a host.

A region is freed when no view of it is left, so an image that is being sent stays intact.
"""

from __future__ import annotations

import ctypes
import mmap
import resource
from collections import deque
from functools import cache
from typing import Any

import wasmtime

from lfield.vm.memory.block_allocator import HEAP_ALLOCATOR, Buffer
from lfield.vm.wasm.wasm_compiler import ADDRESS_SPACE, PAGE, compiler

#: The reservations, tried in this order if the address space is limited (`ulimit -v`).
RESERVATIONS = (ADDRESS_SPACE, 1 << 30, 1 << 28, 1 << 26, 1 << 24)
#: The smallest size of a region. There are four sizes between two powers of two.
_SMALLEST = 512
#: Freed regions of at least this size return their memory, which causes a page fault per page on reuse.
_LARGE = 4 << 20
_advise = ctypes.CDLL(None, use_errno=True).madvise
_advise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
#: Minimum growth in pages: growing takes a system call, unused pages take no memory.
_STEP = 16


class Arena:
    """The memory and its free regions. The first `low` bytes are not used for blocks."""

    def __init__(self, low: int = PAGE) -> None:
        self.reservation, self.store, self.memory = _reserved(-(-low // PAGE))
        #: Base address of the memory in this process; constant.
        self.address = ctypes.addressof(self.memory.data_ptr(self.store).contents)
        self._next = low + -low % 8
        self._free: dict[int, list[int]] = {}
        #: Regions freed since the last allocation: Python's collector may free during one.
        self._freed: deque[tuple[int, int]] = deque()

    def view(self, base: int, size: int) -> memoryview:
        """`size` bytes at a place in the memory, valid as long as the arena."""
        return memoryview((ctypes.c_ubyte * size).from_address(self.address + base)).cast("B")

    def allocate(self, size: int) -> Buffer:
        """A region; if the memory is full, bytes outside it, which only the reference engine can use."""
        capacity = size_class(size)
        base = self.allocate_region(capacity)
        if base < 0:
            return HEAP_ALLOCATOR.allocate(size)
        region = _region(capacity).from_address(self.address + base)
        region.arena, region.base = self, base
        return memoryview(region).cast("B")[:size]

    def resize(self, data: Buffer, size: int) -> Buffer:
        """The same region if its size class fits, otherwise another one."""
        region = data.obj if isinstance(data, memoryview) else None
        if isinstance(region, Region) and len(region) == size_class(size):
            return memoryview(region).cast("B")[:size]
        copy = self.allocate(size)
        copied = min(size, len(data))
        copy[:copied] = data[:copied]
        return copy

    def base(self, data: Buffer) -> int:
        """The start of a region in the memory, in bytes; -1 for bytes outside the memory."""
        region = data.obj if isinstance(data, memoryview) else None
        if isinstance(region, Region) and region.arena is self:
            return region.base
        return -1

    def allocate_region(self, capacity: int) -> int:
        """Allocate `capacity` bytes (a size class) until they are freed; -1 if the arena is full."""
        while self._freed:
            base, size = self._freed.popleft()
            self._free.setdefault(size, []).append(base)
        free = self._free.get(capacity)
        if free:
            return free.pop()
        base = self._extend(capacity)
        return base if base >= 0 else self._coalesce(capacity)

    def free(self, base: int, capacity: int) -> None:
        """Free a region without views; the memory of a large region is returned to the system.

        May be called at any time, even during `allocate_region`.
        """
        if capacity >= _LARGE:
            start = self.address + base
            first, last = start + -start % mmap.PAGESIZE, (start + capacity) // mmap.PAGESIZE * mmap.PAGESIZE
            _advise(first, last - first, mmap.MADV_DONTNEED)
        self._freed.append((base, capacity))

    def _coalesce(self, capacity: int) -> int:
        """Merge adjacent freed regions into one; the rest remains free. -1 if this is impossible."""
        runs: list[tuple[int, int]] = []
        for base, size in sorted((base, size) for size, bases in self._free.items() for base in bases):
            before, known = runs[-1] if runs else (base, 0)
            if before + known == base:
                runs[-1:] = [(before, known + size)]
            else:
                runs.append((base, size))
        if runs and sum(runs[-1]) == self._next:
            self._next = runs.pop()[0]
        self._free = {}
        for base, size in runs:
            self._free.setdefault(size, []).append(base)
        large = min((size for size in self._free if size >= capacity), default=0)
        if not large:
            return self._extend(capacity)
        base = self._free[large].pop()
        if large > capacity:
            self._free.setdefault(large - capacity, []).append(base + capacity)
        return base

    def _extend(self, capacity: int) -> int:
        """A new region at the end of the memory, which grows; -1 if this is impossible.

        The last page is unused, so the address after a region also fits 32 bits.
        """
        base, end = self._next, self._next + capacity
        size = self.memory.data_len(self.store)
        if end > size:
            pages = max(-(-(end - size) // PAGE), _STEP)
            pages = min(pages, (self.reservation - PAGE - size) // PAGE)
            if end > size + pages * PAGE or not self._grow(pages):
                return -1
        self._next = end
        return base

    def _grow(self, pages: int) -> bool:
        try:
            self.memory.grow(self.store, pages)
        except wasmtime.WasmtimeError:
            return False
        return True


class Region(ctypes.Array[ctypes.c_ubyte]):
    """The bytes of one region; views keep it alive."""

    _type_ = ctypes.c_ubyte
    _length_ = 0
    arena: Arena
    base: int

    def __del__(self) -> None:
        self.arena.free(self.base, len(self))


def size_class(size: int) -> int:
    """The size of the region for `size` bytes: at most a quarter more."""
    if size <= _SMALLEST:
        return _SMALLEST
    step = 1 << (size - 1).bit_length() - 3
    return size + -size % step


@cache
def _region(capacity: int) -> type[Region]:
    return type("Region", (Region,), {"_length_": capacity})


def _reserved(pages: int) -> tuple[int, Any, wasmtime.Memory]:
    """A memory with the largest possible reservation: addresses, store, memory."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    maximum = ADDRESS_SPACE if limit == resource.RLIM_INFINITY else limit // 4
    for reservation in RESERVATIONS:
        if reservation > max(maximum, RESERVATIONS[-1]):
            continue
        try:
            store = wasmtime.Store(compiler(reservation))
            kind = wasmtime.MemoryType(wasmtime.Limits(pages, reservation // PAGE))
            return reservation, store, wasmtime.Memory(store, kind)
        except wasmtime.WasmtimeError:
            continue
    raise MemoryError("no addresses are left for an arena; raise the limit of addresses (ulimit -v)")

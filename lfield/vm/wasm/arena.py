"""The arena: one WebAssembly memory with the blocks of all agents of a host, each in a region of its own.

A region is freed when nobody has a view of it any more, so an image that is still being sent stays whole.
"""

from __future__ import annotations

import ctypes
import mmap
import resource
from collections import deque
from functools import cache
from typing import Any

import wasmtime

from lfield.vm.memory.space import SEPARATE, Buffer
from lfield.vm.wasm.compiling import PAGE, WHOLE, compiler

#: What is tried, one after another, where addresses are limited (`ulimit -v`).
RESERVATIONS = (WHOLE, 1 << 30, 1 << 28, 1 << 26, 1 << 24)
#: Regions have one of four sizes between two powers of two; this is the smallest.
_SMALLEST = 512
#: Freed regions of so many bytes keep no memory: it costs a fault for each page to have it again.
_LARGE = 4 << 20
_advise = ctypes.CDLL(None, use_errno=True).madvise
_advise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
#: A memory grows by so many pages at least: growing costs a call of the system, untouched pages cost nothing.
_STEP = 16


class Arena:
    """The memory, and which regions of it are free. The first `low` bytes are not given to blocks."""

    def __init__(self, low: int = PAGE) -> None:
        self.reservation, self.store, self.memory = _reserved(-(-low // PAGE))
        #: Where the memory begins, in this process; it never moves.
        self.address = ctypes.addressof(self.memory.data_ptr(self.store).contents)
        self._next = low + -low % 8
        self._free: dict[int, list[int]] = {}
        #: What was freed since something was taken: the collector of Python may free while that is done.
        self._freed: deque[tuple[int, int]] = deque()

    def view(self, base: int, size: int) -> memoryview:
        """So many bytes from a place in the memory, for as long as the arena is there."""
        return memoryview((ctypes.c_ubyte * size).from_address(self.address + base)).cast("B")

    def room(self, size: int) -> Buffer:
        """A region; bytes elsewhere, which only the reference engine can use, where the memory is full."""
        capacity = size_class(size)
        base = self.take(capacity)
        if base < 0:
            return SEPARATE.room(size)
        region = _region(capacity).from_address(self.address + base)
        region.arena, region.base = self, base
        return memoryview(region).cast("B")[:size]

    def sized(self, data: Buffer, size: int) -> Buffer:
        """The same region where its size class fits, else another one."""
        region = data.obj if isinstance(data, memoryview) else None
        if isinstance(region, Region) and len(region) == size_class(size):
            return memoryview(region).cast("B")[:size]
        made = self.room(size)
        kept = min(size, len(data))
        made[:kept] = data[:kept]
        return made

    def base(self, data: Buffer) -> int:
        """Where a region begins in the memory, in bytes; -1 for bytes that are not in this one."""
        region = data.obj if isinstance(data, memoryview) else None
        if isinstance(region, Region) and region.arena is self:
            return region.base
        return -1

    def take(self, capacity: int) -> int:
        """Where so many bytes (a size class) are that are nobody's until they are freed; -1: nowhere."""
        while self._freed:
            base, size = self._freed.popleft()
            self._free.setdefault(size, []).append(base)
        free = self._free.get(capacity)
        if free:
            return free.pop()
        base = self._fresh(capacity)
        return base if base >= 0 else self._joined(capacity)

    def free(self, base: int, capacity: int) -> None:
        """Nobody has a view of a region any more; the system has the memory of a large one back.

        It may be called at any moment, in the middle of `take` too.
        """
        if capacity >= _LARGE:
            start = self.address + base
            first, last = start + -start % mmap.PAGESIZE, (start + capacity) // mmap.PAGESIZE * mmap.PAGESIZE
            _advise(first, last - first, mmap.MADV_DONTNEED)
        self._freed.append((base, capacity))

    def _joined(self, capacity: int) -> int:
        """A region of freed ones that lie side by side; what is left over stays free. -1: nowhere."""
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
            return self._fresh(capacity)
        base = self._free[large].pop()
        if large > capacity:
            self._free.setdefault(large - capacity, []).append(base + capacity)
        return base

    def _fresh(self, capacity: int) -> int:
        """A new region from the end of the memory, which grows for it; -1 when it cannot.

        The last page is nobody's: the address behind a region is one of 32 bits too, in the code as here.
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
    """The bytes of one region; views of them keep it."""

    _type_ = ctypes.c_ubyte
    _length_ = 0
    arena: Arena
    base: int

    def __del__(self) -> None:
        self.arena.free(self.base, len(self))


def size_class(size: int) -> int:
    """The size of the region for so many bytes: at most a quarter more."""
    if size <= _SMALLEST:
        return _SMALLEST
    step = 1 << (size - 1).bit_length() - 3
    return size + -size % step


@cache
def _region(capacity: int) -> type[Region]:
    return type("Region", (Region,), {"_length_": capacity})


def _reserved(pages: int) -> tuple[int, Any, wasmtime.Memory]:
    """A memory with as many addresses as can be had: how many, its store and itself."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    most = WHOLE if limit == resource.RLIM_INFINITY else limit // 4
    for reservation in RESERVATIONS:
        if reservation > max(most, RESERVATIONS[-1]):
            continue
        try:
            store = wasmtime.Store(compiler(reservation))
            kind = wasmtime.MemoryType(wasmtime.Limits(pages, reservation // PAGE))
            return reservation, store, wasmtime.Memory(store, kind)
        except wasmtime.WasmtimeError:
            continue
    raise MemoryError("no addresses are left for an arena; raise the limit of addresses (ulimit -v)")

"""Region allocator with native heap operations: blocks are collected, copied and verified in WebAssembly.

The Python code of `lfield.vm.memory` is the specification; results are identical bytes. It also handles
blocks outside the arena and undecided cases.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from lfield.vm.memory.block_allocator import Buffer, VerifiedHeap
from lfield.vm.memory.heap_schema import HeapSchema, SuspensionPoints
from lfield.vm.memory.layout import HEADER_WORDS, TICKET_WORDS, Layouts
from lfield.vm.reference.step_compiler import PreparedProgram
from lfield.vm.wasm.arena import Arena, size_class
from lfield.vm.wasm.machine_code import CodeCache, runtime_of
from lfield.vm.wasm.native_calls import unsigned
from lfield.vm.wasm.runtime.runtime_functions import RuntimeFunctions
from lfield.vm.wasm.runtime.runtime_tables import layout_tables, schema_tables, suspension_tables
from lfield.vm.wasm.wasm_compiler import PAGE

#: Maximum references copied at once, a number above the arguments of any call.
MOST_ROOTS = 64


class HeapArena(Arena):
    """An arena whose blocks are collected, copied and verified without Python.

    A program's code may be compiled together with the runtime's.
    """

    is_native = True

    def __init__(
        self, low: int = PAGE, cache: CodeCache | None = None, program: PreparedProgram | None = None
    ) -> None:
        super().__init__(low)
        runtime = runtime_of(self.reservation, cache, program)
        self.functions = RuntimeFunctions(runtime, self.store, self.memory)
        functions = self.functions
        self._collect, self._copy, self._verify_heap = (
            functions.collect,
            functions.deep_copy,
            functions.verify_heap,
        )
        self._can_migrate = functions.can_migrate
        self._tables: dict[Layouts | HeapSchema | SuspensionPoints, int] = {}
        #: Scratch memory for one call, and its size.
        self._scratch, self._capacity = -1, 0
        self._scratch_view = self.view(0, 0)
        #: Roots of the copier, as an address and as words.
        self._roots_at = self.allocate_region(size_class(8 * MOST_ROOTS))
        self._roots = self.view(self._roots_at, 8 * MOST_ROOTS).cast("q")

    def collect(self, source: Buffer, target: Buffer, layouts: Layouts) -> int:
        """See the Protocol; both must be in the arena."""
        old, new = self.base(source), self.base(target)
        tables = self._table_address(layouts)
        if old < 0 or new < 0 or tables < 0:
            return 0
        return unsigned(self._collect(tables, old, len(source) // 8, new, len(target) // 8, HEADER_WORDS))

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
        """See the Protocol; both must be in the arena, with a limited number of roots."""
        old, new, count = self.base(source), self.base(target), len(roots)
        size = 16 * (used + count + 2)
        tables, scratch = self._table_address(layouts), self._scratch_for(size)
        if old < 0 or new < 0 or tables < 0 or scratch < 0 or count > MOST_ROOTS:
            return None
        words = self._roots
        for i, root in enumerate(roots):
            words[i] = root
        at = self._roots_at
        reached = self._copy(tables, old, used, new, top, end, at, count, scratch, scratch + size)
        return words[:count].tolist(), reached

    def verify_heap(self, data: Buffer, heap: int, top: int, schema: HeapSchema) -> VerifiedHeap | None:
        """See the Protocol; None also for errors, which the Python code then reports."""
        bits, tickets, scratch = self._marks(top)
        block, tables = self.base(data), self._table_address(schema)
        if block < 0 or tables < 0 or scratch < 0:
            return None
        count = unsigned(self._verify_heap(tables, block, heap, top, scratch, scratch + 8 * bits))
        if count > tickets:
            return None
        starts = ObjectStarts(self._scratch_view, memoryview(data).cast("q"), top)
        places = self._scratch_view[8 * bits : 8 * (bits + count)].cast("q").tolist() if count else []
        return starts, places

    def can_migrate(self, data: Buffer, top: int, suspension_points: SuspensionPoints) -> bool:
        """See the Protocol."""
        bits, _, scratch = self._marks(top)
        block, tables, positions = (
            self.base(data),
            self._table_address(suspension_points.schema),
            self._table_address(suspension_points),
        )
        if block < 0 or tables < 0 or positions < 0 or scratch < 0:
            return False
        return bool(self._can_migrate(tables, positions, block, top, scratch, scratch + 8 * bits) & 1)

    def _marks(self, top: int) -> tuple[int, int, int]:
        """Scratch for the marks of the verifier: one bit per word, then one word per ticket.

        Returns their number of words, and the address of the first.
        """
        bits, tickets = top // 64 + 1, top // TICKET_WORDS
        return bits, tickets, self._scratch_for(8 * (bits + tickets))

    def _table_address(self, program_data: Layouts | HeapSchema | SuspensionPoints) -> int:
        """The address of a program's tables; -1 when the arena is full."""
        found = self._tables.get(program_data)
        if found is None:
            tables = _bytes_of(program_data)
            found = self._tables[program_data] = self.allocate_region(size_class(len(tables)))
            if found >= 0:
                self.view(found, len(tables))[:] = tables
        return found

    def _scratch_for(self, size: int) -> int:
        """The address of scratch bytes, valid until the next call; -1 when the arena is full."""
        if size > self._capacity:
            if self._scratch >= 0:
                self.free(self._scratch, self._capacity)
            self._capacity = size_class(size)
            self._scratch = self.allocate_region(self._capacity)
            if self._scratch < 0:
                self._capacity = 0
            self._scratch_view = self.view(max(0, self._scratch), self._capacity)
        return self._scratch


def _bytes_of(program_data: Layouts | HeapSchema | SuspensionPoints) -> bytes:
    match program_data:
        case Layouts():
            return layout_tables(program_data)
        case HeapSchema():
            return schema_tables(program_data)
        case SuspensionPoints():
            return suspension_tables(program_data)


class ObjectStarts(Mapping[int, int]):
    """Starts of objects on a heap, each with the lower half of its header; valid until the next check."""

    def __init__(self, bits: memoryview, w: memoryview[int], top: int) -> None:
        self._bits, self._w, self._top = bits, w, top

    def __getitem__(self, place: int) -> int:
        if 0 <= place < self._top and self._bits[place >> 3] >> (place & 7) & 1:
            return self._w[place] & 0xFFFFFFFF
        raise KeyError(place)

    def get(self, place: int, default: int = 0) -> int:  # type: ignore[override]  # only these operations are used
        """The value of a key, without an internal exception, because the method is called several times per
        hop.
        """
        if 0 <= place < self._top and self._bits[place >> 3] >> (place & 7) & 1:
            return self._w[place] & 0xFFFFFFFF
        return default

    def __iter__(self) -> Iterator[int]:
        return (place for place in range(self._top) if place in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)

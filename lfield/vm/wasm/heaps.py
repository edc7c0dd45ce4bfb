"""The arena with what is done to heaps: blocks in it are collected, copied and checked in WebAssembly.

The Python of `lfield.vm.memory` is the specification; here is the same work on the same bytes, to the same
bytes. Whatever lies elsewhere, and what is not sure, is left to it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from lfield.vm.memory.layout import HEADER_WORDS, TICKET_WORDS, Layouts
from lfield.vm.memory.shapes import Shapes, Stances
from lfield.vm.memory.space import Buffer, Walked
from lfield.vm.reference.prepare import Prepared
from lfield.vm.wasm.arena import Arena, size_class
from lfield.vm.wasm.calls import unsigned
from lfield.vm.wasm.code import Cache, runtime_of
from lfield.vm.wasm.compiling import PAGE
from lfield.vm.wasm.runtime.functions import Functions
from lfield.vm.wasm.runtime.tables import layout_tables, shape_tables, stance_tables

#: The most references that are copied at once: more than any call has arguments.
MOST_ROOTS = 64


class Heaps(Arena):
    """An arena whose blocks need no Python to be collected, copied and checked.

    The code of a program may be made with that of the runtime.
    """

    def __init__(self, low: int = PAGE, cache: Cache | None = None, program: Prepared | None = None) -> None:
        super().__init__(low)
        runtime = runtime_of(self.reservation, cache, program)
        self.functions = Functions(runtime, self.store, self.memory)
        functions = self.functions
        self._collect, self._copy, self._sound = functions.collect, functions.deep_copy, functions.sound
        self._travels = functions.travels
        self._tables: dict[Layouts | Shapes | Stances, int] = {}
        #: What is used for the length of one call, and how large it is.
        self._scratch, self._capacity = -1, 0
        self._scratch_view = self.view(0, 0)
        #: Where the copier finds its roots, as an address and as words.
        self._roots_at = self.take(size_class(8 * MOST_ROOTS))
        self._roots = self.view(self._roots_at, 8 * MOST_ROOTS).cast("q")

    def collected(self, source: Buffer, target: Buffer, layouts: Layouts) -> int:
        """As the Protocol says; both are in the arena."""
        old, new = self.base(source), self.base(target)
        tables = self._laid(layouts)
        if old < 0 or new < 0 or tables < 0:
            return 0
        return unsigned(self._collect(tables, old, len(source) // 8, new, len(target) // 8, HEADER_WORDS))

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
        """As the Protocol says; both are in the arena, and there are not very many roots."""
        old, new, count = self.base(source), self.base(target), len(roots)
        size = 16 * (used + count + 2)
        tables, scratch = self._laid(layouts), self._room_for(size)
        if old < 0 or new < 0 or tables < 0 or scratch < 0 or count > MOST_ROOTS:
            return None
        words = self._roots
        for i, root in enumerate(roots):
            words[i] = root
        at = self._roots_at
        reached = self._copy(tables, old, used, new, top, end, at, count, scratch, scratch + size)
        return words[:count].tolist(), reached

    def walked(self, data: Buffer, heap: int, top: int, shapes: Shapes) -> Walked | None:
        """As the Protocol says; None too when something is wrong, which the Python then finds."""
        bits, tickets, scratch = self._marks(top)
        block, tables = self.base(data), self._laid(shapes)
        if block < 0 or tables < 0 or scratch < 0:
            return None
        count = unsigned(self._sound(tables, block, heap, top, scratch, scratch + 8 * bits))
        if count > tickets:
            return None
        starts = Starts(self._scratch_view, memoryview(data).cast("q"), top)
        places = self._scratch_view[8 * bits : 8 * (bits + count)].cast("q").tolist() if count else []
        return starts, places

    def travels(self, data: Buffer, top: int, stances: Stances) -> bool:
        """As the Protocol says."""
        bits, _, scratch = self._marks(top)
        block, tables, stood = self.base(data), self._laid(stances.shapes), self._laid(stances)
        if block < 0 or tables < 0 or stood < 0 or scratch < 0:
            return False
        return bool(self._travels(tables, stood, block, top, scratch, scratch + 8 * bits) & 1)

    def _marks(self, top: int) -> tuple[int, int, int]:
        """Where the soundness check makes its marks: one bit for each word, then a word for each ticket.

        How many words they are, and the address of the first.
        """
        bits, tickets = top // 64 + 1, top // TICKET_WORDS
        return bits, tickets, self._room_for(8 * (bits + tickets))

    def _laid(self, what: Layouts | Shapes | Stances) -> int:
        """The address of the tables of a program; -1 when there is no room for them."""
        found = self._tables.get(what)
        if found is None:
            tables = _bytes_of(what)
            found = self._tables[what] = self.take(size_class(len(tables)))
            if found >= 0:
                self.view(found, len(tables))[:] = tables
        return found

    def _room_for(self, size: int) -> int:
        """The address of some bytes that are used until this is called again; -1 when there is no room."""
        if size > self._capacity:
            if self._scratch >= 0:
                self.free(self._scratch, self._capacity)
            self._capacity = size_class(size)
            self._scratch = self.take(self._capacity)
            if self._scratch < 0:
                self._capacity = 0
            self._scratch_view = self.view(max(0, self._scratch), self._capacity)
        return self._scratch


def _bytes_of(what: Layouts | Shapes | Stances) -> bytes:
    match what:
        case Layouts():
            return layout_tables(what)
        case Shapes():
            return shape_tables(what)
        case Stances():
            return stance_tables(what)


class Starts(Mapping[int, int]):
    """Where things begin on a heap, each with the low half of its header; valid until the next check."""

    def __init__(self, bits: memoryview, w: memoryview[int], top: int) -> None:
        self._bits, self._w, self._top = bits, w, top

    def __getitem__(self, place: int) -> int:
        if 0 <= place < self._top and self._bits[place >> 3] >> (place & 7) & 1:
            return self._w[place] & 0xFFFFFFFF
        raise KeyError(place)

    def get(self, place: int, default: int = 0) -> int:  # type: ignore[override]  # all that is asked for
        """As of every mapping, without an exception on the way: this is asked several times in each hop."""
        if 0 <= place < self._top and self._bits[place >> 3] >> (place & 7) & 1:
            return self._w[place] & 0xFFFFFFFF
        return default

    def __iter__(self) -> Iterator[int]:
        return (place for place in range(self._top) if place in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)

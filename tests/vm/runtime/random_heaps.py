"""Random programs and random heaps of them: all kinds of objects, references of valid types."""

from __future__ import annotations

import random
from functools import cache

from lfield.bytecode.program import Program
from lfield.testing.golden import compile_text
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.block_allocator import BlockAllocator
from lfield.vm.memory.heap_schema import ANY_FRAME, ANY_OBJECT, HeapSchema
from lfield.vm.memory.layout import Layouts
from lfield.vm.wasm.heap_arena import HeapArena

#: Types of fields, C stands for some class.
TYPES = ("int", "real", "boolean", "string", "C", "C[]", "int[]", "real[]", "string[]", "C[][]", "int[][]")
#: The team: two resources of different types, and the coordinator.
MEMBERS = ("R", "Q", "Boss")
LIMIT = 1 << 17
#: Characters of one to four bytes, for texts of all lengths around a word.
LETTERS = "aZ0 é߿ࠀ€퟿\ue000\uffff\U00010000\U0010ffff"

PROGRAM = """
{classes}
resource R {{
    C0 mine;
    init(string[] arg) {{ while (true) yield(); }}
    portal ask(int n, string s) emit C0 {{ return mine; }}
}}
resource Q {{ init(string[] arg) {{ }} }}
coordinator Boss {{
    R r; Q[] all; {fields}
    init(string[] arg) {{
        r = findR("r"); all = findQ();
        C0[] got = new C0[3]; C0 one; R[] rs = findR(); {growth}
        try {{ work(1, "x", got); throw new C0(); }}
        catch (C0 e) {{ together {{ got[1] = rs[0].ask(1, "a"); one = rs[1].ask(2, "b"); }} }}
    }}
    private int work(int a, string b, C0[] c) {{ real x = 1.5; C0 d = c[0]; r.ask(a, b); return a; }}
}}
"""


#: Statements that make types of arrays growable.
GROWTH = (
    "got.append(one);",
    "int[] ints = {}; ints.append(1);",
    "string[] texts = {}; texts.pop();",
    "C0[][] lists = {}; lists.append(got);",
)


@cache
def random_program(seed: int) -> Program:
    """A program with a few classes that have fields of all types."""
    rng = random.Random(seed)
    count = rng.randint(1, 4)

    def fields() -> str:
        kinds = (rng.choice(TYPES).replace("C", f"C{rng.randrange(count)}") for _ in range(rng.randint(0, 7)))
        return " ".join(f"public {kind} f{i};" for i, kind in enumerate(kinds))

    classes = "\n".join(f"class C{i} {{ {fields()} }}" for i in range(count))
    # In most programs some types of arrays grow.
    growth = " ".join(rng.choice(("", line)) for line in GROWTH)
    return compile_text(
        PROGRAM.format(classes=classes, fields=fields().replace("public ", ""), growth=growth)
    )


@cache
def layouts_of(program: Program) -> Layouts:
    return Layouts(program)


@cache
def shapes_of(program: Program) -> HeapSchema:
    return HeapSchema(program, layouts_of(program), MEMBERS)


@cache
def heaps() -> HeapArena:
    """One arena for all of these tests: regions are reused with their old contents."""
    return HeapArena()


class RandomHeap:
    """A block with a random heap. `tickets`: it may have some with random contents."""

    def __init__(self, seed: int, *, version: int = layout.VERSION, tickets: bool = True) -> None:
        self.program = random_program(seed % 23)
        self.layouts, self.shapes = layouts_of(self.program), shapes_of(self.program)
        self.rng = random.Random(seed)
        self.block = Block.empty(self.program.digest, LIMIT)
        self.block.replace(bytearray(8 * 16384), layout.HEADERS[version])
        w = self.block.w
        w[:5] = memoryview(Block.empty(self.program.digest, LIMIT).data).cast("q")[:5]
        w[layout.W_MAGIC] = layout.MAGIC | version << 32
        halves = [half for half in self.shapes.sizes if tickets or half & 0xFF != layout.TICKET]
        self.places = [self._thing(half) for half in self.rng.choices(halves, k=self.rng.randint(1, 40))]
        for place in filter(None, self.places):
            self._lead(place)
        self.places = [place for place in self.places if place]
        for word, kind in ((layout.W_SELF, ANY_OBJECT), (layout.W_ID, layout.STRING)):
            w[word] = self.some(kind)
        w[layout.W_THREADS] = self.some(layout.THREAD)
        w[layout.W_TOP] = self.block.top

    def some(self, expected: int) -> int:
        """The target of a reference with that expected type, or null."""
        w, shapes = self.block.w, self.shapes
        found = [
            place
            for place in self.places
            if place
            and (w[place] & 0xFFFFFFFF == expected or shapes.is_kind(w[place] & 0xFFFFFFFF, expected))
        ]
        return self.rng.choice([0, *found, *found])

    def _thing(self, half: int) -> int:
        """One object with random words; 0 when it is impossible."""
        rng, block, kind = self.rng, self.block, half & 0xFF
        if kind == layout.STRING:
            return block.new_string("".join(rng.choices(LETTERS, k=rng.choice([0, 1, 3, 8, 30]))))
        if kind == layout.GROWABLE:
            core = self.program.core
            return block.new_array(half >> 8, core.plain_array(half >> 8), rng.choice([0, 1, 2, 5, 40]))
        size = self.shapes.sizes[half] or 1 + rng.choice([0, 1, 2, 5, 40])
        place = block.allocate(kind, half >> 8, size)
        for i in range(place + 1, place + size):
            block.w[i] = rng.choice([0, 1, -1, rng.getrandbits(63), -rng.getrandbits(62)])
        if kind == layout.PROXY:
            members = [i for i, of in enumerate(self.shapes.members) if of == half >> 8]
            if not members:
                block.top = place
                return 0
            block.w[place + 1], block.w[place + 2] = rng.choice(members), rng.getrandbits(20)
        return place

    def _lead(self, place: int) -> None:
        """Set the references of an object."""
        w = self.block.w
        if w[place] & 0xFF == layout.GROWABLE:
            # The object's own array or another one, and spare words.
            array = layout.GROWABLE_ARRAY
            w[place + array] = self.some(self.shapes.references(w[place])[0][1]) or w[place + array]
            w[place + layout.GROWABLE_LENGTH] = self.rng.randrange(w[w[place + array]] >> 32)
            return
        expects = dict(self.shapes.references(w[place]))
        for offset in self.layouts.references(w[place]):
            otherwise = layout.THREAD if offset == layout.THREAD_NEXT else ANY_FRAME
            w[place + offset] = self.some(expects.get(offset, otherwise))

    def roots(self) -> list[int]:
        """A few references, some of them null or the same."""
        return self.rng.choices([0, *self.places], k=self.rng.randint(0, 5))


def twin(block: Block, space: BlockAllocator) -> Block:
    """The same block with bytes from a space."""
    data = space.allocate(len(block.data))
    data[:] = block.data
    return Block(data, block.top, block.limit, space)

"""What offers a capability, as the host found it, and the objects in the block that tell L of it.

For a capability the compiler makes a class: its first field holds what an offer says about itself (FACTS),
each other one stands for a way in which the capability can be served. Of an offer only the fields of its
own way are filled: a proxy, or the offers that stand in for it.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from lfield.bytecode.program import ARRAY, FACTS, OBJECT, PROXY, Program, TypeRecord
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import header


@dataclass(frozen=True, slots=True)
class Found:
    """Somebody who can do it now.

    `way` is the field of the capability's class that stands for how. Directly, that is a proxy for the agent
    with the number `member`; otherwise `parts` are the offers in the fields they belong to. `kind` says the
    same in words. For each attribute there is a name, a number (NaN when it is none), a text (None: show the
    number) and an age in seconds; the four are equally long.
    """

    way: str
    agent: str
    host: str
    kind: str
    score: float
    member: int = -1
    parts: Mapping[str, Found] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    numbers: tuple[float, ...] = ()
    texts: tuple[str | None, ...] = ()
    ages: tuple[float, ...] = ()


class UnknownWay(Exception):
    """An offer by a way that the program was not built with; the message says which."""


class Shape:
    """The class of a capability: its index, and the fields of its objects behind the first, in order.

    The object that puts several parts together is filled by no offer: L makes it at the first call.
    """

    def __init__(self, program: Program, index: int) -> None:
        core = program.core
        record = core.classes[index]
        self.name, self.index = record.name, index
        self.fields = [f.name for f in record.fields[1:]]
        kinds = [core.types[f.type] for f in record.fields[1:]]
        self._ways = {name: (kind.kind, kind.of) for name, kind in zip(self.fields, kinds, strict=True)}
        self._parts = {kind.of for kind in kinds if kind.kind == OBJECT and core.classes[kind.of].capability}

    def proxy(self, way: str) -> int:
        """The resource type of a field that holds a proxy; raises UnknownWay."""
        kind, of = self._ways.get(way, (OBJECT, -1))
        if kind != PROXY:
            raise self._unknown(way)
        return of

    def part(self, way: str) -> int:
        """The capability of a field that holds another offer; raises UnknownWay."""
        kind, of = self._ways.get(way, (PROXY, -1))
        if kind != OBJECT or of not in self._parts:
            raise self._unknown(way)
        return of

    def _unknown(self, way: str) -> UnknownWay:
        return UnknownWay(
            f"the program knows no way '{way}' of {self.name}: "
            "build it again with the registry that the hosts have"
        )


class Shapes:
    """The classes of a program's capabilities by class index, and the types that every offer is made of."""

    def __init__(self, program: Program) -> None:
        core = program.core
        kinds = {record: i for i, record in enumerate(core.types)}
        self.of: dict[int, Shape] = {}
        #: The type of an array of offers, where the program has such an array.
        self.arrays: dict[int, int] = {}
        for index, record in enumerate(core.classes):
            if not record.capability:
                continue
            self.of[index] = Shape(program, index)
            array = kinds.get(TypeRecord(ARRAY, kinds.get(TypeRecord(OBJECT, index), -1)))
            if array is not None:
                self.arrays[index] = array
            #: The class of what offers say of themselves, and its two types of arrays.
            self.facts = core.types[record.fields[0].type].of
            self.strings, self.reals = (core.classes[self.facts].fields[i].type for i in (4, 5))


def ways(program: Program) -> dict[str, frozenset[str]]:
    """The capabilities a program was built with: for each the ways in which it can be served."""
    return {
        record.name: frozenset(f.name for f in record.fields if f.name != FACTS)
        for record in program.core.classes
        if record.capability
    }


def write_offers(block: Block, shapes: Shapes, capability: int, found: Sequence[Found]) -> int:
    """An array of offers on the heap; raises Full before it writes anything, and UnknownWay."""
    writer = _Writer(shapes, block.top)
    offers = [writer.offer(shapes.of[capability], one) for one in found]
    place = writer.put(layout.ARRAY, shapes.arrays[capability], offers)
    block.require(len(writer.words))
    end = block.top + len(writer.words)
    block.w[block.top : end] = memoryview(writer.words)
    block.top = end
    return place


class _Writer:
    """The words of things to be, which shall stand from the word `base` on; what is equal is written once."""

    def __init__(self, shapes: Shapes, base: int) -> None:
        self.words = array("q")
        self._shapes, self._base = shapes, base
        self._made: dict[tuple[int, object], int] = {}

    def offer(self, shape: Shape, found: Found) -> int:
        """An offer with all it consists of; where it begins."""
        if found.parts:
            of = self._shapes.of
            filled = {way: self.offer(of[shape.part(way)], part) for way, part in found.parts.items()}
        else:
            filled = {found.way: self.put(layout.PROXY, shape.proxy(found.way), [found.member, 0])}
        own = [self._facts(found), *(filled.get(way, 0) for way in shape.fields)]
        return self.put(layout.OBJECT, shape.index, own)

    def put(self, kind: int, index: int, body: Iterable[int]) -> int:
        """A thing with its header; where it begins."""
        words = array("q", body)
        place = self._base + len(self.words)
        self.words.append(header(kind, index, 1 + len(words)))
        self.words.extend(words)
        return place

    def _facts(self, found: Found) -> int:
        """What an offer says of itself, in the order of the fields of `Offer`."""
        strings, reals = self._shapes.strings, self._shapes.reals
        said = [self._text(found.agent), self._text(found.host), self._text(found.kind)]
        said += _bits([found.score])
        said.append(self._once(strings, found.names, lambda: map(self._text, found.names)))
        said.append(self.put(layout.ARRAY, reals, _bits(found.numbers)))
        said.append(self._once(strings, found.texts, lambda: map(self._text, found.texts)))
        said.append(self._once(reals, found.ages, lambda: _bits(found.ages)))
        return self.put(layout.OBJECT, self._shapes.facts, said)

    def _once(self, type: int, value: tuple[object, ...], body: Callable[[], Iterable[int]]) -> int:
        """The array of some values, the same for all offers that have these."""
        place = self._made.get((type, value))
        if place is None:
            place = self._made[type, value] = self.put(layout.ARRAY, type, body())
        return place

    def _text(self, text: str | None) -> int:
        if text is None:
            return 0
        place = self._made.get((layout.STRING, text))
        if place is None:
            raw = text.encode("utf-8", "replace")
            whole = array("q", raw.ljust(len(raw) + 7 & ~7, b"\0"))
            place = self._made[layout.STRING, text] = self.put(layout.STRING, 0, [len(raw), *whole])
        return place


def _bits(numbers: Iterable[float]) -> array[int]:
    """Reals as the words that they are in a block."""
    return array("q", array("d", numbers).tobytes())

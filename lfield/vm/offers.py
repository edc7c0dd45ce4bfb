"""What offers a capability, as the host found it, and the objects in the block that tell L of it.

For a capability the compiler makes a class: its first field holds what an offer says about itself (FACTS),
each other one stands for a way in which the capability can be served. Of an offer only the fields of its
own way are filled: a proxy, or the offers that stand in for it. There may be a thousand of them, so all are
written at once, and what is equal (a host's name, the ages of what never changes) is written once.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

from lfield.bytecode.program import ARRAY, FACTS, OBJECT, PROXY, Program, TypeRecord
from lfield.vm import layout
from lfield.vm.block import Block, Full
from lfield.vm.layout import header

_STRING = struct.Struct("<2q")
#: Header, agent, host, kind, score, names, numbers, texts, ages.
_FACTS = struct.Struct("<4qd4q")


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


@dataclass(frozen=True, slots=True)
class Shape:
    """The class of a capability: words of its objects, and the ways by name.

    A way has its number among the ways, the kind of its type, and the class of what its field holds.
    """

    index: int
    name: str
    words: int
    ways: Mapping[str, tuple[int, int, int]]


class Shapes:
    """The classes of a program's capabilities, by class index."""

    def __init__(self, program: Program) -> None:
        core = program.core
        kinds = {record: i for i, record in enumerate(core.types)}
        self.of: dict[int, Shape] = {}
        #: The array type of the offers of a capability, where the program has one.
        self.arrays: dict[int, int] = {}
        for index, record in enumerate(core.classes):
            if not record.capability:
                continue
            ways = {
                f.name: (number, core.types[f.type].kind, core.types[f.type].of)
                for number, f in enumerate(record.fields[1:])
            }
            self.of[index] = Shape(index, record.name, 1 + len(record.fields), ways)
            of = kinds.get(TypeRecord(OBJECT, index), -1)
            self.arrays[index] = kinds.get(TypeRecord(ARRAY, of), -1)
            #: The header of what offers say about themselves, and the types of its two kinds of arrays.
            facts = core.types[record.fields[0].type].of
            fields = core.classes[facts].fields
            self.head = header(layout.OBJECT, facts, 1 + len(fields))
            self.strings, self.reals = fields[4].type, fields[5].type


def ways(program: Program) -> dict[str, frozenset[str]]:
    """The capabilities a program was built with: for each the ways in which it can be served."""
    return {
        record.name: frozenset(f.name for f in record.fields if f.name != FACTS)
        for record in program.core.classes
        if record.capability
    }


def write_offers(block: Block, shapes: Shapes, capability: int, found: Sequence[Found]) -> int:
    """An array of offers on the heap; raises Full, and UnknownWay when the program has no such way."""
    writer = _Writer(shapes, block.top)
    shape = shapes.of[capability]
    places = [writer.offer(shape, one) for one in found]
    array = writer.words(header(layout.ARRAY, shapes.arrays[capability], 1 + len(places)), *places)
    data = b"".join(writer.chunks)
    end = block.top + (len(data) >> 3)
    if end > block.end:
        raise Full(end - block.top)
    block.data[8 * block.top : 8 * end] = data
    block.top = end
    return array


class _Writer:
    """The bytes of things to be, each at the place it will have."""

    def __init__(self, shapes: Shapes, top: int) -> None:
        self.chunks: list[bytes] = []
        self._shapes, self._top = shapes, top
        self._texts: dict[str | None, int] = {None: 0}
        self._of_texts: dict[tuple[str | None, ...], int] = {}
        self._of_reals: dict[tuple[float, ...], int] = {}
        self._proxies: dict[tuple[int, int], int] = {}

    def offer(self, shape: Shape, found: Found) -> int:
        """An offer with its parts."""
        fields = [0] * (shape.words - 2)
        if found.parts:
            for name, part in found.parts.items():
                offset, of = self._way(shape, name, OBJECT)
                fields[offset] = self.offer(self._shapes.of[of], part)
        else:
            offset, of = self._way(shape, found.way, PROXY)
            fields[offset] = self._proxy(of, found.member)
        facts = self._facts(found)
        return self.words(header(layout.OBJECT, shape.index, shape.words), facts, *fields)

    def words(self, *words: int) -> int:
        """Something of these words, header first."""
        return self._put(_words(len(words)).pack(*words))

    def _put(self, data: bytes) -> int:
        place = self._top
        self._top += len(data) >> 3
        self.chunks.append(data)
        return place

    def _way(self, shape: Shape, name: str, kind: int) -> tuple[int, int]:
        """Which field it is, and the class of what it holds."""
        way = shape.ways.get(name)
        if way is None or way[1] != kind:
            raise UnknownWay(
                f"the program knows no way '{name}' of {shape.name}: "
                "build it again with the registry that the hosts have"
            )
        return way[0], way[2]

    def _facts(self, found: Found) -> int:
        shapes, text = self._shapes, self._text
        strings = self._strings
        numbers = self._reals(found.numbers)
        return self._put(
            _FACTS.pack(
                shapes.head,
                text(found.agent),
                text(found.host),
                text(found.kind),
                found.score,
                strings(found.names),
                numbers,
                strings(found.texts),
                self._reals(found.ages),
            )
        )

    def _text(self, text: str | None) -> int:
        place = self._texts.get(text)
        if place is None:
            raw = text.encode("utf-8", "replace") if text is not None else b""
            words = len(raw) + 7 >> 3
            head = _STRING.pack(header(layout.STRING, 0, 2 + words), len(raw))
            place = self._texts[text] = self._put(head + raw.ljust(8 * words, b"\0"))
        return place

    def _strings(self, texts: tuple[str | None, ...]) -> int:
        place = self._of_texts.get(texts)
        if place is None:
            head = header(layout.ARRAY, self._shapes.strings, 1 + len(texts))
            place = self._of_texts[texts] = self.words(head, *map(self._text, texts))
        return place

    def _reals(self, numbers: tuple[float, ...]) -> int:
        place = self._of_reals.get(numbers)
        if place is None:
            head = header(layout.ARRAY, self._shapes.reals, 1 + len(numbers))
            place = self._of_reals[numbers] = self._put(_reals(len(numbers)).pack(head, *numbers))
        return place

    def _proxy(self, resource: int, member: int) -> int:
        place = self._proxies.get((resource, member))
        if place is None:
            place = self.words(header(layout.PROXY, resource, 2), member)
            self._proxies[resource, member] = place
        return place


@cache
def _words(count: int) -> struct.Struct:
    return struct.Struct(f"<{count}q")


@cache
def _reals(count: int) -> struct.Struct:
    return struct.Struct(f"<q{count}d")

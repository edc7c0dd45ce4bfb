"""What offers a capability, as the host found it, and the objects in the block that tell L of it.

For a capability the compiler makes a class: its first field holds what an offer says about itself (FACTS),
each other one stands for a way in which the capability can be served. Of an offer only the fields of its
own way are filled: a proxy, or the offers that stand in for it. There may be a thousand of them, so all are
written at once, and what is equal (a host's name, the ages of what never changes) is written once.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

from lfield.bytecode.program import ARRAY, FACT_FIELDS, FACTS, OBJECT, PROXY, Program, TypeRecord
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block, Full
from lfield.vm.memory.layout import header

#: Words of what an offer says of itself: header, agent, host, kind, score, names, numbers, texts, ages.
_FACTS_WORDS = 1 + len(FACT_FIELDS)
#: The first two words of a string, and all of a proxy.
_TWO = struct.Struct("<2q")


class Found(NamedTuple):
    """Somebody who can do it now.

    `way` is the field of the capability's class that stands for how. Directly, that is a proxy for the agent
    with the number `member`; otherwise `parts` are the offers in the fields they belong to. `kind` says the
    same in words. For each attribute there is a name, a number (NaN when it is none), a text (None: show the
    number) and an age in seconds; the four are equally long. A tuple, because there may be a thousand.
    """

    way: str
    agent: str
    host: str
    kind: str
    score: float
    member: int = -1
    parts: Mapping[str, Found] = {}
    names: tuple[str, ...] = ()
    numbers: tuple[float, ...] = ()
    texts: tuple[str | None, ...] = ()
    ages: tuple[float, ...] = ()


class UnknownWay(Exception):
    """An offer by a way that the program was not built with; the message says which."""


class Shape:
    """The class of a capability: words and header of its objects, and by name the fields that may be filled.

    Of each its number among the ways, the kind of its type, and the class of what it holds. The object that
    puts several parts together is none of them: L makes it at the first call.
    """

    def __init__(self, program: Program, index: int) -> None:
        classes = program.core.classes
        record = classes[index]
        fields = [program.core.types[f.type] for f in record.fields[1:]]
        self.name = record.name
        self.words = 1 + len(record.fields)
        self.head = header(layout.OBJECT, index, self.words)
        self.ways_count = len(fields)
        self.ways = {
            f.name: (number, kind.kind, kind.of)
            for number, (f, kind) in enumerate(zip(record.fields[1:], fields, strict=True))
            if kind.kind == PROXY or (kind.kind == OBJECT and classes[kind.of].capability)
        }
        self._direct: dict[tuple[str, int], tuple[struct.Struct, int]] = {}

    def direct(self, way: str, numbers: int) -> tuple[struct.Struct, int]:
        """An offer of which just that way is filled, what it says of itself, so many numbers, and a proxy.

        With it comes the header of the proxy.
        """
        found = self._direct.get((way, numbers))
        if found is None:
            number, of = self.way(way, PROXY)
            before, after = 8 * number, 8 * (self.ways_count - number - 1)
            run = struct.Struct(f"<2q{before}xq{after}x4qd4qq{numbers}d2q")
            found = self._direct[way, numbers] = (run, header(layout.PROXY, of, 2))
        return found

    def way(self, name: str, kind: int) -> tuple[int, int]:
        """Which way it is, and the class of what its field holds. Raises UnknownWay."""
        number, held, of = self.ways.get(name, (0, 0, 0))
        if held != kind:
            raise UnknownWay(
                f"the program knows no way '{name}' of {self.name}: "
                "build it again with the registry that the hosts have"
            )
        return number, of


class Shapes:
    """The classes of a program's capabilities, by class index."""

    def __init__(self, program: Program) -> None:
        core = program.core
        kinds = {record: i for i, record in enumerate(core.types)}
        self.of: dict[int, Shape] = {}
        #: The header of an array of offers without elements, where the program has such an array.
        self.arrays: dict[int, int] = {}
        for index, record in enumerate(core.classes):
            if not record.capability:
                continue
            self.of[index] = Shape(program, index)
            array = kinds.get(TypeRecord(ARRAY, kinds.get(TypeRecord(OBJECT, index), -1)))
            if array is not None:
                self.arrays[index] = header(layout.ARRAY, array, 0)
            #: The headers of what offers say of themselves, and of its two kinds of arrays without elements.
            facts = core.types[record.fields[0].type].of
            self.facts = header(layout.OBJECT, facts, _FACTS_WORDS)
            strings, reals = (core.classes[facts].fields[i].type for i in (4, 5))
            self.strings, self.reals = header(layout.ARRAY, strings, 0), header(layout.ARRAY, reals, 0)


def ways(program: Program) -> dict[str, frozenset[str]]:
    """The capabilities a program was built with: for each the ways in which it can be served."""
    return {
        record.name: frozenset(f.name for f in record.fields if f.name != FACTS)
        for record in program.core.classes
        if record.capability
    }


def write_offers(block: Block, shapes: Shapes, capability: int, found: Sequence[Found]) -> int:
    """An array of offers on the heap; raises Full, and UnknownWay when the program has no such way."""
    shape = shapes.of[capability]
    # What each needs in any case: itself, what it says, its numbers, its place in the array.
    least = 1 + len(found) * (shape.words + _FACTS_WORDS + 2) + sum([len(one.numbers) for one in found])
    if block.top + least > block.end:
        # To write a thousand offers only to find that out would cost more than to count.
        raise Full(least)
    writer = _Writer(shapes, block.top)
    array = writer.array(shapes.arrays[capability], writer.offers(shape, found))
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
        self._lists: dict[tuple[str | None, ...], int] = {}
        self._ages: dict[tuple[float, ...], int] = {}

    def offers(self, shape: Shape, found: Sequence[Found]) -> list[int]:
        """The places of some offers; what each says of itself, its numbers and its proxy follow it."""
        shapes, chunks = self._shapes, self.chunks
        known_text, known_list, known_ages = self._texts.get, self._lists.get, self._ages.get
        places = []
        # Written out, because a thousand offers go through here: a call or two for each would be half of it.
        for one in found:
            way, agent, host, kind, score, member, parts, names, numbers, texts, ages = one
            if parts:
                places.append(self._of_parts(shape, one))
                continue
            agent_at = known_text(agent) or self._text(agent)
            host_at = known_text(host) or self._text(host)
            kind_at = known_text(kind) or self._text(kind)
            names_at = known_list(names) or self._strings(names)
            texts_at = known_list(texts) or self._strings(texts)
            ages_at = known_ages(ages) or self._reals(ages)
            count = len(numbers)
            run, proxy = shape.direct(way, count)
            place = self._top
            facts = place + shape.words
            array = facts + _FACTS_WORDS
            behind = array + 1 + count
            data = run.pack(
                shape.head,
                facts,
                behind,
                shapes.facts,
                agent_at,
                host_at,
                kind_at,
                score,
                names_at,
                array,
                texts_at,
                ages_at,
                shapes.reals | 1 + count << 32,
                *numbers,
                proxy,
                member,
            )
            chunks.append(data)
            self._top = behind + 2
            places.append(place)
        return places

    def _of_parts(self, shape: Shape, found: Found) -> int:
        """An offer that others stand in for."""
        ways = [0] * shape.ways_count
        for name, part in found.parts.items():
            number, of = shape.way(name, OBJECT)
            (ways[number],) = self.offers(self._shapes.of[of], [part])
        text, count = self._text, len(found.numbers)
        said = (text(found.agent), text(found.host), text(found.kind), found.score)
        names, texts, ages = self._strings(found.names), self._strings(found.texts), self._reals(found.ages)
        facts = self._top + shape.words
        first = (
            shape.head,
            facts,
            *ways,
            self._shapes.facts,
            *said,
            names,
            facts + _FACTS_WORDS,
            texts,
            ages,
        )
        head = self._shapes.reals | 1 + count << 32
        return self._put(struct.pack(f"<{2 + len(ways)}q4qd4qq{count}d", *first, head, *found.numbers))

    def array(self, head: int, places: Sequence[int]) -> int:
        """An array of references; `head` is its header without elements."""
        count = 1 + len(places)
        return self._put(struct.pack(f"<{count}q", head | count << 32, *places))

    def _put(self, data: bytes) -> int:
        place = self._top
        self._top += len(data) >> 3
        self.chunks.append(data)
        return place

    def _text(self, text: str | None) -> int:
        place = self._texts.get(text)
        if place is None:
            place = self._texts[text] = self._put(_string(text or ""))
        return place

    def _strings(self, texts: tuple[str | None, ...]) -> int:
        place = self._lists.get(texts)
        if place is None:
            places = [self._text(text) for text in texts]
            place = self._lists[texts] = self.array(self._shapes.strings, places)
        return place

    def _reals(self, numbers: tuple[float, ...]) -> int:
        place = self._ages.get(numbers)
        if place is None:
            head = self._shapes.reals | 1 + len(numbers) << 32
            place = self._ages[numbers] = self._put(struct.pack(f"<q{len(numbers)}d", head, *numbers))
        return place


@lru_cache(maxsize=4096)
def _string(text: str) -> bytes:
    """A string as it stands on the heap."""
    raw = text.encode("utf-8", "replace")
    words = len(raw) + 7 >> 3
    return _TWO.pack(header(layout.STRING, 0, 2 + words), len(raw)) + raw.ljust(8 * words, b"\0")

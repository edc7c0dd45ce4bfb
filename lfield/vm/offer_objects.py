"""Offers of capabilities as found by the host, and their objects in a block.

The compiler creates a class for a capability: the first field is an offer's description (FACTS), each other
field stands for one realisation of the capability. In an offer only the fields of its realisation are set: a
proxy, or the offers of its components.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence

from msgspec import Struct, field

from lfield.bytecode.program import FACTS, OBJECT, OLDEST_FACTS, PROXY, Program, TypeRecord
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import header


class FoundOffer(Struct, frozen=True):
    """One present offer.

    `realisation` is the field of the capability's class. A direct offer is a proxy for the agent number
    `member`; otherwise `parts` are the offers by field. `kind` is the name of the realisation.
    Attributes have a name, a number (NaN for none), a text (None: show the number), an age in seconds (NaN:
    constant) and a source; the five sequences have equal lengths. `found` is the number of offers (0 for a
    component), and `note` describes omitted data.
    """

    realisation: str
    agent: str
    host: str
    kind: str
    score: float
    member: int = -1
    parts: Mapping[str, FoundOffer] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    numbers: tuple[float, ...] = ()
    texts: tuple[str | None, ...] = ()
    ages: tuple[float, ...] = ()
    sources: tuple[str, ...] = ()
    found: int = 0
    note: str = ""


class SearchIncomplete(Exception):
    """No offer was found, and the search was not exhaustive; the message has the reason."""


class UnknownRealisation(Exception):
    """An offer by a realisation that is not in the program; the message names it."""


class OfferClass:
    """The class of a capability: its index, and the fields of its objects after the first, in order.

    The object that combines several components is created by L at the first call.
    """

    def __init__(self, program: Program, index: int) -> None:
        core = program.core
        record = core.classes[index]
        self.name, self.index = record.name, index
        self.fields = [f.name for f in record.fields[1:]]
        kinds = [core.types[f.type] for f in record.fields[1:]]
        self._fields = {name: (kind.kind, kind.of) for name, kind in zip(self.fields, kinds, strict=True)}
        self._parts = {kind.of for kind in kinds if kind.kind == OBJECT and core.classes[kind.of].capability}

    def proxy(self, realisation: str) -> int:
        """The resource type of a field that holds a proxy. Raises UnknownWay."""
        kind, target = self._fields.get(realisation, (OBJECT, -1))
        if kind != PROXY:
            raise self._unknown(realisation)
        return target

    def part(self, realisation: str) -> int:
        """The capability of a field that holds another offer. Raises UnknownWay."""
        kind, target = self._fields.get(realisation, (PROXY, -1))
        if kind != OBJECT or target not in self._parts:
            raise self._unknown(realisation)
        return target

    def _unknown(self, realisation: str) -> UnknownRealisation:
        return UnknownRealisation(
            f"the program has no realisation '{realisation}' of {self.name}: "
            "build it again with the registry that the hosts have"
        )


class OfferClasses:
    """The classes of a program's capabilities by class index, and the common types of offers."""

    def __init__(self, program: Program) -> None:
        core = program.core
        kinds = {record: i for i, record in enumerate(core.types)}
        self.by_class: dict[int, OfferClass] = {}
        created = core.created_arrays()
        self._plain = [core.plain_array(i) for i in range(len(core.types))]
        #: The type of an array of offers, and of an array of such arrays, if the program has them.
        self.arrays: dict[int, int] = {}
        self.teams: dict[int, int] = {}
        for index, record in enumerate(core.classes):
            if not record.capability:
                continue
            self.by_class[index] = OfferClass(program, index)
            array = created.get(kinds.get(TypeRecord(OBJECT, index), -1))
            if array is not None:
                self.arrays[index] = array
                self.teams[index] = created.get(array, -1)
            #: The class of descriptions, and its two array types.
            self.facts = core.types[record.fields[0].type].of
            #: The number of fields of descriptions, which is lower in programs of an older lfield.
            self.fact_count = len(core.classes[self.facts].fields)
            self.strings, self.reals = (core.classes[self.facts].fields[i].type for i in (4, 5))

    def plain_array(self, kind: int) -> int:
        """The type of the ARRAY with the elements of an array type."""
        return self._plain[kind]


def realisations(program: Program) -> dict[str, frozenset[str]]:
    """The capabilities in a program, each with its realisations."""
    return {
        record.name: frozenset(f.name for f in record.fields if f.name != FACTS)
        for record in program.core.classes
        if record.capability
    }


def write_offers(
    block: Block, offer_classes: OfferClasses, capability: int, found: Sequence[FoundOffer], now: float
) -> int:
    """An array of offers on the heap. Raises HeapFull before any write, and UnknownWay.

    `now` is the coordinator's clock in seconds, from which ages grow.
    """
    writer = _Writer(offer_classes, block.top, now)
    return _written(block, writer, writer.offers(capability, found))


def write_teams(
    block: Block,
    offer_classes: OfferClasses,
    capability: int,
    found: Sequence[Sequence[FoundOffer]],
    now: float,
) -> int:
    """An array of teams, each an array of offers. Raises the errors of `write_offers`."""
    writer = _Writer(offer_classes, block.top, now)
    teams = [writer.offers(capability, team) for team in found]
    return _written(block, writer, writer.array(offer_classes.teams[capability], teams))


def _written(block: Block, writer: _Writer, place: int) -> int:
    block.require(len(writer.words))
    end = block.top + len(writer.words)
    block.w[block.top : end] = memoryview(writer.words)
    block.set_top(end)
    return place


class _Writer:
    """Writes new objects from the word `base` on; equal objects are written once."""

    def __init__(self, offer_classes: OfferClasses, base: int, now: float) -> None:
        self.words = array("q")
        self._shapes, self._base, self._now = offer_classes, base, now
        self._shared_places: dict[tuple[int, object], int] = {}

    def offers(self, capability: int, found: Sequence[FoundOffer]) -> int:
        """An array of offers; returns its place."""
        offers = [self.offer(self._shapes.by_class[capability], offer) for offer in found]
        return self.array(self._shapes.arrays[capability], offers)

    def offer(self, shape: OfferClass, found: FoundOffer) -> int:
        """An offer with its components; returns its place."""
        if found.parts:
            classes = self._shapes.by_class
            filled = {
                realisation: self.offer(classes[shape.part(realisation)], part)
                for realisation, part in found.parts.items()
            }
        else:
            filled = {
                found.realisation: self.put(layout.PROXY, shape.proxy(found.realisation), [found.member, 0])
            }
        own = [self._facts(found), *(filled.get(name, 0) for name in shape.fields)]
        return self.put(layout.OBJECT, shape.index, own)

    def put(self, kind: int, index: int, body: Iterable[int]) -> int:
        """An object with its header; returns its place."""
        words = array("q", body)
        place = self._base + len(self.words)
        self.words.append(header(kind, index, 1 + len(words)))
        self.words.extend(words)
        return place

    def array(self, kind: int, body: Iterable[int]) -> int:
        """An array of a type with these elements; returns its place."""
        plain = self._shapes.plain_array(kind)
        words = array("q", body)
        if plain == kind:
            return self.put(layout.ARRAY, kind, words)
        place = self._base + len(self.words)
        self.put(layout.GROWABLE, kind, [len(words), place + layout.GROWABLE_WORDS])
        self.put(layout.ARRAY, plain, words)
        return place

    def _facts(self, found: FoundOffer) -> int:
        """The description of an offer, in the order of the fields of `Offer`."""
        strings, reals = self._shapes.strings, self._shapes.reals
        description = [self._text(found.agent), self._text(found.host), self._text(found.kind)]
        description += _bits([found.score])
        description.append(self._shared_array(strings, found.names, lambda: map(self._text, found.names)))
        description.append(self.array(reals, _bits(found.numbers)))
        description.append(self._shared_array(strings, found.texts, lambda: map(self._text, found.texts)))
        ages = found.ages if self._shapes.fact_count > OLDEST_FACTS else tuple(map(_still, found.ages))
        description.append(self._shared_array(reals, _comparable(ages), lambda: _bits(ages)))
        description += [found.found, self._text(found.note)]
        description.append(self._shared_array(strings, found.sources, lambda: map(self._text, found.sources)))
        description += _bits([self._now])
        return self.put(layout.OBJECT, self._shapes.facts, description[: self._shapes.fact_count])

    def _shared_array(self, type: int, value: tuple[object, ...], body: Callable[[], Iterable[int]]) -> int:
        """The array of some values, shared by all offers with equal values."""
        place = self._shared_places.get((type, value))
        if place is None:
            place = self._shared_places[type, value] = self.array(type, body())
        return place

    def _text(self, text: str | None) -> int:
        if text is None:
            return 0
        place = self._shared_places.get((layout.STRING, text))
        if place is None:
            raw = text.encode("utf-8", "replace")
            padded = array("q", raw.ljust(len(raw) + 7 & ~7, b"\0"))
            place = self._shared_places[layout.STRING, text] = self.put(layout.STRING, 0, [len(raw), *padded])
        return place


def _still(age: float) -> float:
    """An age as programs of lfield 0.4 have it: 0 if constant."""
    return 0.0 if math.isnan(age) else age


def _comparable(numbers: Iterable[float]) -> tuple[object, ...]:
    """Comparable numbers: NaN equals NaN."""
    return tuple(None if number != number else number for number in numbers)


def _bits(numbers: Iterable[float]) -> array[int]:
    """Reals as words of a block."""
    return array("q", array("d", numbers).tobytes())

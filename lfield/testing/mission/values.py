"""Between values in a block and Python: what portals are called with, give and throw, for tests of missions.

    L                       Python
    int, real, boolean      int, float, bool
    string                  str
    an array                a list
    an object               an LObject
    null, and nothing       None

A proxy crosses no portal. Aliases and circles are kept both ways, and no depth is too deep.
"""

from __future__ import annotations

from collections.abc import Sequence

from lfield.bytecode.disassemble import type_name
from lfield.bytecode.program import (
    ARRAY,
    BESIDE,
    BOOLEAN,
    INT,
    OBJECT,
    REAL,
    REFERENCES,
    STRING,
    VOID,
    FieldRecord,
    Program,
)
from lfield.testing.mission.answers import LObject
from lfield.vm.inspect import traceback
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block, Full
from lfield.vm.memory.copier import deep_copy
from lfield.vm.memory.layout import HEADER_WORDS, Layouts
from lfield.vm.memory.values import real_of, word_of

#: The words of the first block in which a value is made.
FIRST_WORDS = 512
#: The largest int that may stand for a real.
MOST_REAL = 1 << 1000


class Mismatch(Exception):
    """A Python value that is none of an L type: `wanted` is that as L writes it, `came` what is wrong."""

    def __init__(self, wanted: str, came: str) -> None:
        self.wanted, self.came = wanted, came
        super().__init__(f"{came} is no {wanted}")


# --- out of a block -----------------------------------------------------------------------------------


def values_of(block: Block, program: Program, kinds: Sequence[int], words: Sequence[int]) -> list[object]:
    """The values that words of these types (by index) are; what they share is shared."""
    return _Reader(block, program).values(kinds, words)


def type_word(program: Program, kind: int) -> str:
    """A type (by index) as L writes it, and `nothing` for none."""
    return type_name(program, kind) if program.core.types[kind].kind != VOID else "nothing"


def thrown_of(block: Block, program: Program, place: int) -> str:
    """The exception at a place, as `Kind: message`; of one of the program's own classes the class alone."""
    kind, message, _ = traceback.describe(block, program, place)
    return f"{kind}: {message}" if message else kind


class _Reader:
    """Reads one block; objects and arrays are made empty first and filled after, one after another."""

    def __init__(self, block: Block, program: Program) -> None:
        self._block, self._program = block, program
        self._made: dict[int, LObject | list[object]] = {}
        self._empty: list[int] = []

    def values(self, kinds: Sequence[int], words: Sequence[int]) -> list[object]:
        found = [self._value(kind, word) for kind, word in zip(kinds, words, strict=True)]
        while self._empty:
            self._fill(self._empty.pop())
        return found

    def _value(self, kind: int, word: int) -> object:
        of = self._program.core.types[kind].kind
        if of == BOOLEAN:
            return bool(word)
        if of == REAL:
            return real_of(word)
        if of == INT:
            return word
        return self._reference(word) if of in REFERENCES and word else None

    def _reference(self, place: int) -> object:
        head = self._block.w[place]
        if head & 0xFF == layout.STRING:
            return self._block.string(place)
        if place not in self._made:
            is_array = head & 0xFF == layout.ARRAY
            name = "" if is_array else self._program.core.classes[head >> 8 & 0xFFFFFF].name
            self._made[place] = [] if is_array else LObject(name)
            self._empty.append(place)
        return self._made[place]

    def _fill(self, place: int) -> None:
        w, made = self._block.w, self._made[place]
        index, end = w[place] >> 8 & 0xFFFFFF, place + (w[place] >> 32)
        if isinstance(made, list):
            of = self._program.core.types[index].of
            made.extend(self._value(of, word) for word in w[place + 1 : end])
            return
        fields = own_fields(self._program, index)
        found = {field.name: self._value(field.type, w[place + 1 + i]) for i, field in fields}
        assert isinstance(made.fields, dict)
        made.fields.update(found)


def own_fields(program: Program, index: int) -> list[tuple[int, FieldRecord]]:
    """The fields of a class with their places, but for what the machine puts beside an exception."""
    beside = program.others.get(index, -1)
    fields = enumerate(program.core.classes[index].fields)
    return [(i, field) for i, field in fields if i != beside and field.name != BESIDE]


# --- into a block -------------------------------------------------------------------------------------


class Made:
    """A Python value as one of an L type (by index), in a block of its own until `put` copies it.

    Raises Mismatch when it is of another type.
    """

    def __init__(self, program: Program, kind: int, value: object) -> None:
        self._layouts = Layouts(program)
        self._refers = program.core.types[kind].kind in REFERENCES
        words = FIRST_WORDS
        while True:
            self._block = Block(bytearray(8 * words), HEADER_WORDS, words)
            try:
                self._word = _Writer(self._block, self._layouts, program).write(kind, value)
                return
            except Full as full:
                words = 2 * words + full.words

    def put(self, block: Block) -> int:
        """Its word in a block; raises Full before it writes anything."""
        if not self._refers or not self._word:
            return self._word
        return deep_copy(self._block, [self._word], block, self._layouts)[0]


class _Writer:
    """Writes one value; objects and arrays get their room first and are filled after, one after another."""

    def __init__(self, block: Block, layouts: Layouts, program: Program) -> None:
        self._block, self._layouts, self._program = block, layouts, program
        #: The places of what was made, by the identity of the Python object and the type.
        self._made: dict[tuple[int, int], int] = {}
        self._empty: list[tuple[int, list[tuple[int, int, object]]]] = []

    def write(self, kind: int, value: object) -> int:
        word = self._word(kind, value)
        while self._empty:
            place, parts = self._empty.pop()
            for offset, of, part in parts:
                # First the word, which may need room: the block's views are of the moment.
                made = self._word(of, part)
                self._block.w[place + offset] = made
        return word

    def _word(self, kind: int, value: object) -> int:
        of = self._program.core.types[kind].kind
        match value:
            case None if of == VOID or of in REFERENCES:
                return 0
            case bool() if of == BOOLEAN:
                return int(value)
            case int() if of == INT and not isinstance(value, bool) and -(1 << 63) <= value < 1 << 63:
                return value
            case float() if of == REAL:
                return word_of(value)
            case int() if of == REAL and not isinstance(value, bool) and abs(value) <= MOST_REAL:
                return word_of(float(value))
            case str() if of == STRING:
                return self._block.new_string(value)
            case list() | tuple() if of == ARRAY:
                return self._array(kind, value)
            case LObject() if of == OBJECT:
                return self._object(kind, value)
        raise self._mismatch(kind, f"{type(value).__name__} {_clipped(value)}")

    def _mismatch(self, kind: int, came: str) -> Mismatch:
        return Mismatch(type_word(self._program, kind), came)

    def _array(self, kind: int, values: Sequence[object]) -> int:
        key = id(values), kind
        if key not in self._made:
            of = self._program.core.types[kind].of
            self._made[key] = place = self._block.allocate(layout.ARRAY, kind, 1 + len(values))
            self._empty.append((place, [(i, of, value) for i, value in enumerate(values, 1)]))
        return self._made[key]

    def _object(self, kind: int, value: LObject) -> int:
        key = id(value), kind
        if key in self._made:
            return self._made[key]
        index = self._program.core.types[kind].of
        name = self._program.core.classes[index].name
        fields = own_fields(self._program, index)
        if value.class_name != name:
            raise self._mismatch(kind, f"an object of {value.class_name}")
        if {field.name for _, field in fields} != value.fields.keys():
            names = ", ".join(field.name for _, field in fields) or "no fields"
            raise self._mismatch(kind, f"{_clipped(value)}, whose fields are not {names},")
        self._made[key] = place = self._block.allocate(layout.OBJECT, index, self._layouts.class_words[index])
        self._empty.append((place, [(1 + i, field.type, value.fields[field.name]) for i, field in fields]))
        return place


def _clipped(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:79]}…"

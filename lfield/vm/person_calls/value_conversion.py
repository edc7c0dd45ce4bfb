"""Converts portal arguments, results and exceptions between blocks and Python.

    L                       Python
    int, real, boolean      int, float, bool
    string                  str
    a member of an enum     its name, a str
    an array                a list
    a map                   a dict
    an object               an LObject
    null, and nothing       None

Proxies cannot be passed to portals. Aliases and cycles are preserved, and the depth is not limited.
"""

from __future__ import annotations

from collections.abc import Sequence

from lfield.bytecode.disassembler import type_name
from lfield.bytecode.program import (
    ARRAYS,
    BOOLEAN,
    INT,
    OBJECT,
    REAL,
    REFERENCES,
    STRING,
    SUPPRESSED_FIELD,
    VOID,
    FieldRecord,
    Program,
)
from lfield.vm.inspection import traceback
from lfield.vm.inspection.block_view import entry_types, is_map_class, map_entries
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block, HeapFull
from lfield.vm.memory.copier import deep_copy
from lfield.vm.memory.layout import HEADER_WORDS, Layouts
from lfield.vm.memory.word_codec import bits_of_real, real_from_bits
from lfield.vm.person_calls.l_object import LObject

#: Initial size of a new block, in words.
INITIAL_BLOCK_SIZE = 512
#: The largest int that may be used for a real.
MAX_INT_AS_REAL = 1 << 1000


class Mismatch(Exception):
    """A Python value that does not match an L type: `expected` is the type as in L, `problem` the problem of
    the value.
    """

    def __init__(self, expected: str, problem: str) -> None:
        self.expected, self.problem = expected, problem
        super().__init__(f"{problem} is not {'an' if expected[0] in 'aeiou' else 'a'} {expected}")


# --- from a block ---------------------------------------------------------------------------------


def values_of(block: Block, program: Program, kinds: Sequence[int], cells: Sequence[int]) -> list[object]:
    """The values of words with these types (by index); aliases are preserved."""
    return _Reader(block, program).values(kinds, cells)


def type_text(program: Program, kind: int) -> str:
    """A type (by index) as in L, `nothing` for none."""
    return type_name(program, kind) if program.core.types[kind].kind != VOID else "nothing"


def thrown_of(block: Block, program: Program, place: int) -> str:
    """The exception at a place, as `Kind: message`; only the class for the program's own classes."""
    kind, message = thrown_parts(block, program, place)
    return f"{kind}: {message}" if message else kind


def thrown_parts(block: Block, program: Program, place: int) -> tuple[str, str]:
    """The class of the exception at a place, and its message; '' for the program's own classes."""
    kind, message, _ = traceback.describe(block, program, place)
    return kind, message


class _Reader:
    """Reads one block; objects and arrays are created empty and filled iteratively."""

    def __init__(self, block: Block, program: Program) -> None:
        self._block, self._program = block, program
        self._values: dict[int, LObject | list[object] | dict[object, object]] = {}
        self._empty: list[int] = []

    def values(self, kinds: Sequence[int], cells: Sequence[int]) -> list[object]:
        found = [self._value(kind, word) for kind, word in zip(kinds, cells, strict=True)]
        while self._empty:
            self._fill(self._empty.pop())
        return found

    def _value(self, kind: int, cell: int) -> object:
        value_kind = self._program.core.types[kind].kind
        if value_kind == BOOLEAN:
            return bool(cell)
        if value_kind == REAL:
            return real_from_bits(cell)
        if value_kind == INT:
            members = self._program.core.enum_members(kind)
            return members[cell] if 0 <= cell < len(members) else cell
        return self._reference(cell) if value_kind in REFERENCES and cell else None

    def _reference(self, place: int) -> object:
        head = self._block.w[place]
        if head & 0xFF == layout.STRING:
            return self._block.string(place)
        if place not in self._values:
            self._values[place] = self._new(head)
            self._empty.append(place)
        return self._values[place]

    def _new(self, head: int) -> LObject | list[object] | dict[object, object]:
        """The empty Python value for an array, a map or an object."""
        if head & 0xFF in layout.ARRAYS_ON_HEAP:
            return []
        index = head >> 8 & 0xFFFFFF
        return {} if is_map_class(self._program, index) else LObject(self._program.core.classes[index].name)

    def _fill(self, place: int) -> None:
        w, container = self._block.w, self._values[place]
        index = w[place] >> 8 & 0xFFFFFF
        if isinstance(container, dict):
            key, value_type = entry_types(self._program, index)
            for k, v in map_entries(self._block, place):
                container[self._value(key, k)] = self._value(value_type, v)
            return
        if isinstance(container, list):
            element_type = self._program.core.element(index)
            first, end = layout.elements(w, place)
            container.extend(self._value(element_type, word) for word in w[first:end])
            return
        fields = own_fields(self._program, index)
        found = {field.name: self._value(field.type, w[place + 1 + i]) for i, field in fields}
        assert isinstance(container.fields, dict)
        container.fields.update(found)


def own_fields(program: Program, index: int) -> list[tuple[int, FieldRecord]]:
    """The fields of a class with their places, without the VM's additions to exceptions."""
    suppressed = program.others.get(index, -1)
    fields = enumerate(program.core.classes[index].fields)
    return [(i, field) for i, field in fields if i != suppressed and field.name != SUPPRESSED_FIELD]


# --- into a block ---------------------------------------------------------------------------------


class EncodedValue:
    """A Python value as an L type (by index), in its own block until `put` copies it.

    Raises Mismatch if the value has another type.
    """

    def __init__(self, program: Program, kind: int, value: object) -> None:
        self._layouts = Layouts(program)
        self._refers = program.core.types[kind].kind in REFERENCES
        words = INITIAL_BLOCK_SIZE
        while True:
            self._block = Block(bytearray(8 * words), HEADER_WORDS, words)
            try:
                self._cell = _Writer(self._block, self._layouts, program).write(kind, value)
                return
            except HeapFull as full:
                words = 2 * words + full.words

    def put(self, block: Block) -> int:
        """Copy the value into a block, and return its word. Raises HeapFull before any write."""
        if not self._refers or not self._cell:
            return self._cell
        return deep_copy(self._block, [self._cell], block, self._layouts)[0]


class _Writer:
    """Writes one value; objects and arrays are allocated first and filled iteratively."""

    def __init__(self, block: Block, layouts: Layouts, program: Program) -> None:
        self._block, self._layouts, self._program = block, layouts, program
        #: Places of created objects, by identity of the Python object and type.
        self._places: dict[tuple[int, int], int] = {}
        self._empty: list[tuple[int, list[tuple[int, int, object]]]] = []
        #: Lists made by this object, which are kept so that an identity in `_places` is not used again.
        self._alive: list[object] = []

    def write(self, kind: int, value: object) -> int:
        word = self._cell(kind, value)
        while self._empty:
            place, parts = self._empty.pop()
            for offset, of, part in parts:
                # The word is first, because it may need an allocation, which invalidates the block's views.
                cell = self._cell(of, part)
                self._block.w[place + offset] = cell
        return word

    def _cell(self, kind: int, value: object) -> int:
        of = self._program.core.types[kind].kind
        members = self._program.core.enum_members(kind)
        if members and value in members:
            return members.index(str(value))
        match value:
            case None if of == VOID or of in REFERENCES:
                return 0
            case bool() if of == BOOLEAN:
                return int(value)
            case int() if (
                of == INT and not members and not isinstance(value, bool) and -(1 << 63) <= value < 1 << 63
            ):
                return value
            case float() if of == REAL:
                return bits_of_real(value)
            case int() if of == REAL and not isinstance(value, bool) and abs(value) <= MAX_INT_AS_REAL:
                return bits_of_real(float(value))
            case str() if of == STRING:
                return self._block.new_string(value)
            case list() | tuple() if of in ARRAYS:
                return self._array(kind, value)
            case dict() if of == OBJECT and is_map_class(self._program, self._program.core.types[kind].of):
                return self._map(kind, value)
            case LObject() if of == OBJECT:
                return self._object(kind, value)
        raise self._mismatch(kind, f"{type(value).__name__} {_clipped(value)}")

    def _mismatch(self, kind: int, problem: str) -> Mismatch:
        return Mismatch(type_text(self._program, kind), problem)

    def _array(self, kind: int, values: Sequence[object]) -> int:
        key = id(values), kind
        if key not in self._places:
            core = self._program.core
            of, plain = core.element(kind), core.plain_array(kind)
            self._places[key] = place = self._block.new_array(kind, plain, len(values))
            first, _ = layout.elements(self._block.w, place)
            self._empty.append((first, [(i, of, value) for i, value in enumerate(values)]))
        return self._places[key]

    def _map(self, kind: int, value: dict[object, object]) -> int:
        """A map with keys and values only: L adds the rest at the first search."""
        key = id(value), kind
        if key not in self._places:
            index = self._program.core.types[kind].of
            fields = self._program.core.classes[index].fields
            place = self._block.allocate(layout.OBJECT, index, self._layouts.class_words[index])
            self._places[key] = place
            if None in value:
                raise self._mismatch(kind, "a dict with a key None")
            parts: list[object] = [list(value), list(value.values()), [], []]
            self._alive += parts
            found = [(1 + i, fields[i].type, part) for i, part in enumerate(parts)]
            self._empty.append((place, [*found, (5, fields[4].type, len(value))]))
        return self._places[key]

    def _object(self, kind: int, value: LObject) -> int:
        key = id(value), kind
        if key in self._places:
            return self._places[key]
        index = self._program.core.types[kind].of
        name = self._program.core.classes[index].name
        fields = own_fields(self._program, index)
        if value.class_name != name:
            raise self._mismatch(kind, f"an object of {value.class_name}")
        if {field.name for _, field in fields} != value.fields.keys():
            names = ", ".join(field.name for _, field in fields) or "no fields"
            raise self._mismatch(kind, f"{_clipped(value)}, whose fields are not {names},")
        size = self._layouts.class_words[index]
        self._places[key] = place = self._block.allocate(layout.OBJECT, index, size)
        self._empty.append((place, [(1 + i, field.type, value.fields[field.name]) for i, field in fields]))
        return place


def _clipped(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:79]}…"

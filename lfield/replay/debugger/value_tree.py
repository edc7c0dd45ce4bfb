"""Values of a block as trees that can be expanded: variables with their L types, and the parts of objects."""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import Struct

from lfield.bytecode.program import (
    ANY,
    ARRAYS,
    BOOLEAN,
    DEVICE,
    INT,
    NULL,
    OBJECT,
    PROXY,
    REAL,
    REFERENCES,
    STRING,
    TICKET,
    VOID,
    Program,
)
from lfield.vm.inspection.block_view import entry_types, is_map, map_entries, value_text
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import FRAME_SLOTS
from lfield.vm.memory.word_codec import real_from_bits

#: Maximum number of parts that are listed.
MAX_PARTS = 1000
#: Levels of objects whose values are compared.
CONTENT_LEVELS = 3
#: Kinds of types whose values may have parts, and of the objects that have them.
_COMPOSITE = (*ARRAYS, OBJECT, ANY)
_WITH_PARTS = (*layout.ARRAYS_ON_HEAP, layout.OBJECT)
_NAMES = {
    VOID: "void",
    BOOLEAN: "boolean",
    INT: "int",
    REAL: "real",
    STRING: "string",
    ANY: "object",
    NULL: "null",
    DEVICE: "device",
    TICKET: "call",
}


class Variable(Struct, frozen=True):
    """A variable or a part of an object: name, type and value as text.

    `word` is the value as in a slot, `kind` its type by index. `has_parts`: the variable can be expanded.
    """

    name: str
    type: str
    value: str
    word: int
    kind: int
    has_parts: bool = False


class NamedMember(Struct, frozen=True, order=True):
    """A member of an enum: members are in the order of their declaration."""

    number: int
    name: str

    def __str__(self) -> str:
        return self.name


#: A type, by index, and the value as in a slot.
RawValue = tuple[int, int]


class ValueReader:
    """Reads the values of one block; `members` are the ids of the deployment, for proxies."""

    def __init__(self, block: Block, program: Program, members: Sequence[str] = ()) -> None:
        self._block, self._program, self._members = block, program, members

    def type_name(self, kind: int) -> str:
        """The name of a type, by index."""
        core = self._program.core
        record = core.types[kind]
        if record.kind in ARRAYS:
            return f"{self.type_name(core.element(kind))}[]"
        if record.kind in (OBJECT, PROXY) or (record.kind == INT and record.of):
            return core.classes[record.of].name
        return _NAMES[record.kind]

    def variable(self, name: str, kind: int, word: int) -> Variable:
        """A value with a name."""
        record = self._program.core.types[kind]
        is_object = record.kind in _COMPOSITE and word != 0
        text = self._text(kind, word)
        has_parts = is_object and self._block.w[word] & 0xFF in _WITH_PARTS
        return Variable(name, self.type_name(kind), text, word, kind, has_parts)

    def locals(self, frame: int) -> list[Variable]:
        """The named variables of the frame at a place; those without a name are temporary."""
        index = self._block.w[frame] >> 8 & 0xFFFFFF
        method, debug = self._program.core.methods[index], self._program.debug.methods
        names = debug[index].names if debug else ()
        words = self._block.w
        return [
            self.variable(name, method.slots[slot], words[frame + FRAME_SLOTS + slot]) for slot, name in names
        ]

    def parts(self, variable: Variable) -> list[Variable]:
        """The fields of an object, or the elements of an array."""
        if not variable.has_parts:
            return []
        w, place = self._block.w, variable.word
        if w[place] & 0xFF == layout.OBJECT:
            return self._object_parts(place)
        element = self._program.core.element(w[place] >> 8 & 0xFFFFFF)
        first, end = layout.elements(w, place)
        size = min(end - first, MAX_PARTS)
        return [self.variable(f"[{number}]", element, w[first + number]) for number in range(size)]

    def _object_parts(self, place: int) -> list[Variable]:
        w = self._block.w
        if is_map(self._block, self._program, place):
            key, value = entry_types(self._program, w[place] >> 8 & 0xFFFFFF)
            entries = map_entries(self._block, place)[:MAX_PARTS]
            return [self.variable(f"[{self._text(key, k)}]", value, v) for k, v in entries]
        fields = self._program.core.classes[w[place] >> 8 & 0xFFFFFF].fields
        return [
            self.variable(field.name, field.type, w[place + 1 + number])
            for number, field in enumerate(fields)
            if not field.is_hidden
        ]

    def _text(self, kind: int, word: int) -> str:
        return value_text(self._block, self._program, kind, word, self._members)

    # --- without texts, for expressions ---------------------------------------------------------------

    def local(self, frame: int, name: str) -> RawValue | None:
        """The variable of that name in the frame at a place, or the field of its object."""
        w, core, debug = self._block.w, self._program.core, self._program.debug.methods
        index = w[frame] >> 8 & 0xFFFFFF
        slots = core.methods[index].slots
        own: RawValue | None = None
        for slot, known in debug[index].names if debug else ():
            found = slots[slot], w[frame + FRAME_SLOTS + slot]
            if known == name:
                return found
            own = found if known == "this" else own
        return None if own is None else self.part(own, name)

    def part(self, value: RawValue, name: str) -> RawValue | None:
        """The field of an object, or the element `[NUMBER]` of an array; None if it has none."""
        kind, place = value
        w, core = self._block.w, self._program.core
        if core.types[kind].kind not in _COMPOSITE or not place:
            return None
        index = w[place] >> 8 & 0xFFFFFF
        if is_map(self._block, self._program, place):
            types = entry_types(self._program, index)
            entries = map_entries(self._block, place)
            # As shown, and as in an expression of a debugger: `["a"]`, `[a]`.
            named_values = (
                (v, f"[{self._text(types[0], k)}]", f"[{self.plain((types[0], k))}]") for k, v in entries
            )
            return next(((types[1], v) for v, *names in named_values if name in names), None)
        if w[place] & 0xFF == layout.OBJECT:
            fields = enumerate(core.classes[index].fields)
            return next(((f.type, w[place + 1 + n]) for n, f in fields if f.name == name), None)
        if w[place] & 0xFF in layout.ARRAYS_ON_HEAP and name.startswith("[") and name[1:-1].isdigit():
            first, end = layout.elements(w, place)
            at = first + int(name[1:-1])
            return (core.element(index), w[at]) if at < end else None
        return None

    def length(self, value: RawValue) -> int | None:
        """The number of elements of an array or map; None for other values."""
        kind, place = value
        if (
            place
            and self._program.core.types[kind].kind == OBJECT
            and is_map(self._block, self._program, place)
        ):
            return len(map_entries(self._block, place))
        is_array = self._program.core.types[kind].kind in ARRAYS and place
        return layout.length(self._block.w, place) if is_array else None

    def plain(self, value: RawValue) -> object:
        """The value for comparisons: a number, a text, None for null, or the place of an object.

        A member of an enum is a NamedMember.
        """
        kind, word = self._program.core.types[value[0]].kind, value[1]
        if kind == BOOLEAN:
            return bool(word)
        if kind == REAL:
            return real_from_bits(word)
        if kind == INT or kind not in REFERENCES:
            members = self._program.core.enum_members(value[0])
            return NamedMember(word, members[word]) if 0 <= word < len(members) else word
        if not word:
            return None
        return self._block.text(word) if kind == STRING else ("object", word)

    def content(self, value: RawValue, levels: int = CONTENT_LEVELS) -> object:
        """The value with its parts, for comparisons with that at another time: places of objects change."""
        kind, word = value
        record = self._program.core.types[kind]
        if record.kind not in _COMPOSITE or not word:
            return self.plain(value)
        w = self._block.w
        form = w[word] & 0xFF
        if form not in _WITH_PARTS:
            return self.plain(value)
        index = w[word] >> 8 & 0xFFFFFF
        first, end = layout.elements(w, word)
        size = end - first
        if not levels:
            return index, size
        if form == layout.OBJECT:
            types = [field.type for field in self._program.core.classes[index].fields]
        else:
            types = [self._program.core.element(index)] * min(size, MAX_PARTS)
        parts = (self.content((field_type, w[first + n]), levels - 1) for n, field_type in enumerate(types))
        return index, size, tuple(parts)

"""Values of a block as trees that can be expanded: variables with their L types, and the parts of objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lfield.bytecode.program import (
    ANY,
    ARRAY,
    BOOLEAN,
    DEVICE,
    INT,
    NULL,
    OBJECT,
    PROXY,
    REAL,
    REFERENCES,
    STRING,
    SUPPRESSED_FIELD,
    TICKET,
    VOID,
    Program,
)
from lfield.vm.inspection.block_view import value_text
from lfield.vm.memory import layout
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import FRAME_SLOTS
from lfield.vm.memory.word_codec import real_from_bits

#: Maximum number of parts that are listed.
MAX_PARTS = 1000
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


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable or a part of an object: name, type and value as text.

    `word` is the value as in a slot, `kind` its type by index. `has_parts`: it can be expanded.
    """

    name: str
    type: str
    value: str
    word: int
    kind: int
    has_parts: bool = False


class ValueReader:
    """Reads the values of one block; `members` are the ids of the deployment, for proxies."""

    def __init__(self, block: Block, program: Program, members: Sequence[str] = ()) -> None:
        self._block, self._program, self._members = block, program, members

    def type_name(self, kind: int) -> str:
        """The name of a type, by index."""
        core = self._program.core
        record = core.types[kind]
        if record.kind == ARRAY:
            return f"{self.type_name(record.of)}[]"
        if record.kind in (OBJECT, PROXY):
            return core.classes[record.of].name
        return _NAMES[record.kind]

    def variable(self, name: str, kind: int, word: int) -> Variable:
        """A value with a name."""
        record = self._program.core.types[kind]
        is_object = record.kind in (ARRAY, OBJECT, ANY) and word != 0
        text = value_text(self._block, self._program, kind, word, self._members)
        has_parts = is_object and self._block.w[word] & 0xFF in (layout.ARRAY, layout.OBJECT)
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

    def agent_fields(self) -> list[Variable]:
        """The fields of the resource or coordinator."""
        own = self._block.w[layout.W_SELF]
        return self._object_parts(own) if own else []

    def parts(self, variable: Variable) -> list[Variable]:
        """The fields of an object, or the elements of an array."""
        if not variable.has_parts:
            return []
        w, place = self._block.w, variable.word
        if w[place] & 0xFF == layout.OBJECT:
            return self._object_parts(place)
        of = self._program.core.types[w[place] >> 8 & 0xFFFFFF].of
        size = min((w[place] >> 32) - 1, MAX_PARTS)
        return [self.variable(f"[{number}]", of, w[place + 1 + number]) for number in range(size)]

    def _object_parts(self, place: int) -> list[Variable]:
        w = self._block.w
        fields = self._program.core.classes[w[place] >> 8 & 0xFFFFFF].fields
        return [
            self.variable(field.name, field.type, w[place + 1 + number])
            for number, field in enumerate(fields)
            if field.name != SUPPRESSED_FIELD
        ]

    def plain(self, variable: Variable) -> object:
        """The value for comparisons: a number, a text, None for null, or the place of an object."""
        kind = self._program.core.types[variable.kind].kind
        word = variable.word
        if kind == BOOLEAN:
            return bool(word)
        if kind == REAL:
            return real_from_bits(word)
        if kind == INT or kind not in REFERENCES:
            return word
        if not word:
            return None
        return self._block.text(word) if kind == STRING else ("object", word)

"""Between words of a block and plain values: what devices take and give, texts, exceptions of the machine."""

from __future__ import annotations

import math
import struct

from lfield.bytecode.program import ARRAY as ARRAY_TYPE
from lfield.bytecode.program import (
    BOOLEAN,
    BUILTIN_CLASSES,
    INT,
    MESSAGE,
    REAL,
    SOURCE,
    STRING,
    Program,
)
from lfield.errors import DeviceError
from lfield.manifest import DeviceValue
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import ARRAY, OBJECT, Layouts

#: The longest message an exception made by the machine carries, in characters, and its room in words.
MESSAGE_LENGTH = 1000
EXCEPTION_WORDS = 16 + MESSAGE_LENGTH // 8
_WORD, _INT = struct.Struct("<q").pack, struct.Struct("<q").unpack
_REAL, _FLOAT = struct.Struct("<d").pack, struct.Struct("<d").unpack


def real_of(word: int) -> float:
    """The real whose bits a word is."""
    return float(_FLOAT(_WORD(word))[0])


#: The bits of every NaN that L can make or be given; the four operations leave them open (decision 58).
NAN_WORD = 0x7FF8 << 48
NAN = real_of(NAN_WORD)


def canonical(value: float) -> float:
    """The same real, and always the same one for not a number."""
    return value if value == value else NAN


def word_of(value: float) -> int:
    """The word that is a real's bits; of whatever is not a number always the same."""
    return int(_INT(_REAL(canonical(value)))[0])


def real_text(value: float) -> str:
    """A real as L writes it: the shortest digits that read back the same, always with a point or exponent."""
    if math.isnan(value) or math.isinf(value):
        return str(value)
    return repr(value)


def plain(block: Block, program: Program, kind: int, word: int) -> DeviceValue:
    """The value a word of a type (by index) is: bool, int, float, str, a list of numbers, or None."""
    record = program.core.types[kind]
    if record.kind == BOOLEAN:
        return bool(word)
    if record.kind == REAL:
        return real_of(word)
    if record.kind == STRING:
        return block.string(word) if word else None
    if record.kind != ARRAY_TYPE:
        return word
    if not word:
        return None
    end = word + (block.w[word] >> 32)
    if program.core.types[record.of].kind == REAL:
        return list(block.r[word + 1 : end])
    return list(block.w[word + 1 : end])


def word_for(block: Block, program: Program, kind: int, value: DeviceValue, device: str) -> int:
    """The word for a device's value of a type; raises Full, and DeviceError when it is of another type."""
    record = program.core.types[kind]
    match value:
        case bool() if record.kind == BOOLEAN:
            return int(value)
        case int() if record.kind == INT and -(1 << 63) <= value < 1 << 63:
            return value
        case int() | float() if record.kind == REAL:
            return word_of(float(value))
        case str() if record.kind == STRING:
            return block.new_string(value)
        case list() if record.kind == ARRAY_TYPE:
            return _array_for(block, program, kind, value)
        case None:
            return 0
    raise DeviceError(device, f"its driver gave {value!r} where its manifest promises another type")


def _array_for(block: Block, program: Program, kind: int, values: list[float] | list[int]) -> int:
    """An array of reals or ints on the heap; raises Full."""
    place = block.allocate(ARRAY, kind, 1 + len(values))
    real = program.core.types[program.core.types[kind].of].kind == REAL
    for i, value in enumerate(values, place + 1):
        block.w[i] = word_of(float(value)) if real else int(value)
    return place


def new_exception(block: Block, layouts: Layouts, kind: str, message: str, source: str = "") -> int:
    """An object of a built-in exception class; raises Full before anything that matters is written."""
    record = BUILTIN_CLASSES.index(kind)
    with block.reserve():
        text = block.new_string(message[:MESSAGE_LENGTH])
        about = block.new_string(source)
        place = block.allocate(OBJECT, record, layouts.class_words[record])
    block.w[place + 1 + MESSAGE] = text
    block.w[place + 1 + SOURCE] = about
    return place

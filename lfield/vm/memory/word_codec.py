"""Codec between words of a block and Python values, for devices, texts and built-in exceptions."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence

from lfield.bytecode.program import (
    ARRAYS,
    BOOLEAN,
    BUILTIN_CLASSES,
    INT,
    MESSAGE,
    REAL,
    SOURCE,
    STRING,
    VOID,
    Program,
)
from lfield.errors import DeviceError
from lfield.manifest import DeviceValue
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import OBJECT, Layouts, elements

#: Maximum length of the message of a built-in exception in characters, and its words.
MESSAGE_LENGTH = 1000
EXCEPTION_WORDS = 16 + MESSAGE_LENGTH // 8
#: The number of shown characters of a value of the wrong type.
MAX_SHOWN = 100
_WORD, _INT = struct.Struct("<q").pack, struct.Struct("<q").unpack
_REAL, _FLOAT = struct.Struct("<d").pack, struct.Struct("<d").unpack


def real_from_bits(word: int) -> float:
    """The real with the bits of a word."""
    return float(_FLOAT(_WORD(word))[0])


#: The bits of every NaN in L, which the four operations do not determine (decision 58).
NAN_WORD = 0x7FF8 << 48
NAN = real_from_bits(NAN_WORD)


def canonical(value: float) -> float:
    """The same real, with one fixed NaN."""
    return value if value == value else NAN


def bits_of_real(value: float) -> int:
    """The word with a real's bits; one fixed word for NaN."""
    return int(_INT(_REAL(canonical(value)))[0])


def real_text(value: float) -> str:
    """A real as L writes it: the shortest digits that are parsed to the same real, always with a point or
    exponent.
    """
    if math.isnan(value) or math.isinf(value):
        return str(value)
    return repr(value)


def decode_value(block: Block, program: Program, kind: int, word: int) -> DeviceValue:
    """The value of a word of a type (by index): bool, int, float, str, a list of numbers, or None."""
    record = program.core.types[kind]
    if record.kind == BOOLEAN:
        return bool(word)
    if record.kind == REAL:
        return real_from_bits(word)
    if record.kind == STRING:
        return block.string(word) if word else None
    if record.kind not in ARRAYS:
        return word
    if not word:
        return None
    first, end = elements(block.w, word)
    if program.core.types[program.core.element(kind)].kind == REAL:
        return list(block.r[first:end])
    return list(block.w[first:end])


def encode_device_value(block: Block, program: Program, kind: int, value: DeviceValue, device: str) -> int:
    """The word of a device's value of a type. Raises HeapFull, and DeviceError for another type.

    Integers widen to real; a text or an array may be None.
    """
    record = program.core.types[kind]
    word = None
    if record.kind == STRING and isinstance(value, str):
        word = block.new_string(value)
    elif record.kind in ARRAYS and isinstance(value, list):
        word = _array_for(block, program, kind, value)
    elif value is None:
        word = 0 if record.kind in (VOID, STRING, *ARRAYS) else None
    else:
        word = _number(record.kind, value)
    if word is None:
        raise DeviceError(
            device, f"its driver returned {_value_text(value)}, but its manifest states another type"
        )
    return word


def _array_for(block: Block, program: Program, kind: int, values: Sequence[object]) -> int | None:
    """An array of numbers on the heap, None if a value has another type. Raises HeapFull."""
    core = program.core
    element_kind = core.types[core.element(kind)].kind
    words = [word for value in values if (word := _number(element_kind, value)) is not None]
    if len(words) < len(values):
        return None
    place = block.new_array(kind, core.plain_array(kind), len(words))
    for i, word in enumerate(words, elements(block.w, place)[0]):
        block.w[i] = word
    return place


def _number(kind: int, value: object) -> int | None:
    """The word of a boolean, int or real; None for another type."""
    if isinstance(value, bool) or kind == BOOLEAN:
        return int(value) if isinstance(value, bool) and kind == BOOLEAN else None
    if kind == INT:
        return value if isinstance(value, int) and -(1 << 63) <= value < 1 << 63 else None
    if kind != REAL or not isinstance(value, int | float):
        return None
    try:
        return bits_of_real(float(value))
    except OverflowError:  # an integer too large for a real
        return None


def _value_text(value: object) -> str:
    """A value in Python's notation, truncated."""
    try:
        text = repr(value)
    except ValueError:
        return "a number of thousands of digits"
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}..."


def new_exception(block: Block, layouts: Layouts, kind: str, message: str, source: str = "") -> int:
    """An object of a built-in exception class. Raises HeapFull before any relevant write."""
    record = BUILTIN_CLASSES.index(kind)
    with block.use_reserve():
        text = block.new_string(message[:MESSAGE_LENGTH])
        about = block.new_string(source)
        place = block.allocate(OBJECT, record, layouts.class_words[record])
    block.w[place + 1 + MESSAGE] = text
    block.w[place + 1 + SOURCE] = about
    return place

"""Operands of a table row: its name, addresses and references, constants, created objects."""

from __future__ import annotations

import re
import struct
from functools import cache
from typing import Any

from lfield.bytecode.program import GROWABLE, PROXY, Core
from lfield.vm.memory.layout import GROWABLE_ARRAY, OBJECT, STRING, header
from lfield.vm.reference.step_compiler import PreparedProgram
from lfield.vm.wasm.lowering.control_flow_graph import LoweredInstruction
from lfield.vm.wasm.lowering.instruction_table import ROWS

#: The maximum size of a string in words; the reference engine creates longer ones.
_LONGEST = 1 << 14
_BRACES = re.compile(r"\{(\w+)\}")


def row_name(prepared: PreparedProgram, slots: tuple[int, ...], i: LoweredInstruction) -> str:
    """The table row for an instruction; '' if it exits."""
    name, types = i.row.name, prepared.program.core.types
    array = _array_type(slots, i)
    if array >= 0 and types[array].kind == GROWABLE:
        return f"{name} of growable"
    if name in ("eqr", "sner") and types[slots[i.quad.b]].kind == PROXY:
        return f"{name} of proxies"
    if name == "lds" and len(image_of(prepared, i)) > _LONGEST:
        return ""
    return name if name in ROWS else ""


def _array_type(slots: tuple[int, ...], i: LoweredInstruction) -> int:
    """The type of the array of an instruction with rows for both kinds of arrays; -1 for others."""
    match i.row.name:
        case "gete":
            return slots[i.quad.b]
        case "pute":
            return slots[i.quad.a]
        case "newarray":
            return i.quad.b
        case "array_len":
            return slots[i.arguments[0]] if i.arguments[0] >= 0 else -1
    return -1


def image_of(prepared: PreparedProgram, i: LoweredInstruction) -> list[int]:
    """The words created by `lds` or `new`."""
    if i.row.name == "new":
        words = prepared.layouts.class_words[i.quad.b]
        return [header(OBJECT, i.quad.b, words), *[0] * (words - 1)]
    text = prepared.program.core.constants[i.quad.b]
    assert isinstance(text, str)
    return text_words(text)


def text_words(text: str) -> list[int]:
    """The words of a string on the heap."""
    raw = text.encode("utf-8", "replace")
    words = len(raw) + 7 >> 3
    return [
        header(STRING, 0, 2 + words),
        len(raw),
        *struct.unpack(f"<{words}q", raw.ljust(8 * words, b"\0")),
    ]


def filled(line: str, fields: dict[str, Any]) -> str:
    """A line with its braces filled."""
    pieces = list(_pieces(line))
    pieces[1::2] = [str(fields[name]) for name in pieces[1::2]]
    return "".join(pieces)


@cache
def _pieces(line: str) -> tuple[str, ...]:
    """The texts of a line and the names in braces, in turn."""
    return tuple(_BRACES.split(line))


@cache
def row_lines(row: str) -> tuple[tuple[str, str, str], ...]:
    """The lines of a row, each with its first word and the rest of the line."""
    lines = [line.strip() for line in row.strip().splitlines()]
    return tuple((*line.partition(" ")[::2], line) for line in lines)


def reference_to(address: str) -> str:
    """The reference to an address in a local."""
    return f"(i64.extend_i32_u (i32.shr_u (i32.sub (local.get {address}) (local.get $base)) (i32.const 3)))"


def address_of(reference: str) -> str:
    """The address of a reference's target."""
    return f"(i32.add (local.get $base) (i32.shl (i32.wrap_i64 {reference}) (i32.const 3)))"


def element_address(index: str) -> str:
    """The code that sets $p, the address of a growable array, to the address of an element."""
    array = f"(i32.wrap_i64 (i64.load offset={8 * GROWABLE_ARRAY} (local.get $p)))"
    word = f"(i32.add (i32.add {array} (i32.wrap_i64 {index})) (i32.const 1))"
    return f"(local.set $p (i32.add (local.get $base) (i32.shl {word} (i32.const 3))))"


def null_purpose(core: Core, slots: tuple[int, ...], i: LoweredInstruction) -> str:
    """The purpose of an object for an instruction, as in the exception for null."""
    match i.row.name:
        case "getf" | "putf":
            slot, field = (i.quad.b, i.quad.c) if i.row.name == "getf" else (i.quad.a, i.quad.b)
            return f"field '{core.classes[core.types[slots[slot]].of].fields[field].name}'"
        case "call":
            return f"call of '{core.methods[i.quad.a].name}'"
        case "array_len":
            return "length"
        case "append" | "insert" | "remove":
            return i.row.name
        case "remove_last":
            return "pop"
    return "element"


def real_constant(value: float) -> str:
    """A real constant; NaN is canonical (decision 58)."""
    return "nan" if value != value else value.hex()

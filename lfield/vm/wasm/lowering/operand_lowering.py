"""Operands of a table row: its name, addresses and references, constants, created objects."""

from __future__ import annotations

import re
import struct
from typing import Any

from lfield.bytecode.program import PROXY
from lfield.vm.memory.layout import OBJECT, STRING, header
from lfield.vm.reference.step_compiler import PreparedProgram
from lfield.vm.wasm.lowering.control_flow_graph import LoweredInstruction
from lfield.vm.wasm.lowering.instruction_table import ROWS

#: Longer strings are created by the reference engine, in words.
_LONGEST = 1 << 14
_BRACES = re.compile(r"\{(\w+)\}")


def row_name(prepared: PreparedProgram, slots: tuple[int, ...], i: LoweredInstruction) -> str:
    """The table row for an instruction; '' if it exits."""
    name = i.row.name
    if name in ("eqr", "sner") and prepared.program.core.types[slots[i.quad.b]].kind == PROXY:
        return f"{name} of proxies"
    if name == "lds" and len(image_of(prepared, i)) > _LONGEST:
        return ""
    return name if name in ROWS else ""


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
    return _BRACES.sub(lambda found: str(fields[found[1]]), line)


def reference_to(address: str) -> str:
    """The reference to an address in a local."""
    return f"(i64.extend_i32_u (i32.shr_u (i32.sub (local.get {address}) (local.get $base)) (i32.const 3)))"


def address_of(reference: str) -> str:
    """The address of a reference's target."""
    return f"(i32.add (local.get $base) (i32.shl (i32.wrap_i64 {reference}) (i32.const 3)))"


def real_constant(value: float) -> str:
    """A real constant; NaN is canonical (decision 58)."""
    return "nan" if value != value else value.hex()

"""What stands in a row of the table: which row it is, addresses and references, constants, made things."""

from __future__ import annotations

import re
import struct
from typing import Any

from lfield.bytecode.program import PROXY
from lfield.vm.memory.layout import OBJECT, STRING, header
from lfield.vm.reference.prepare import Prepared
from lfield.vm.wasm.lower.graph import Instruction
from lfield.vm.wasm.lower.table import ROWS

#: Longer strings are made by the reference engine, in words.
_LONGEST = 1 << 14
_BRACES = re.compile(r"\{(\w+)\}")


def row_name(prepared: Prepared, slots: tuple[int, ...], i: Instruction) -> str:
    """The row of the table that an instruction is lowered by; '' when it leaves."""
    name = i.row.name
    if name in ("eqr", "sner") and prepared.program.core.types[slots[i.quad.b]].kind == PROXY:
        return f"{name} of proxies"
    if name == "lds" and len(image_of(prepared, i)) > _LONGEST:
        return ""
    return name if name in ROWS else ""


def image_of(prepared: Prepared, i: Instruction) -> list[int]:
    """The words of what `lds` or `new` makes."""
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


def filled(line: str, given: dict[str, Any]) -> str:
    """A line with what its braces stand for."""
    return _BRACES.sub(lambda found: str(given[found[1]]), line)


def reference_to(address: str) -> str:
    """The reference that leads to an address in a local."""
    return f"(i64.extend_i32_u (i32.shr_u (i32.sub (local.get {address}) (local.get $base)) (i32.const 3)))"


def address_of(reference: str) -> str:
    """Where the thing is that a reference leads to."""
    return f"(i32.add (local.get $base) (i32.shl (i32.wrap_i64 {reference}) (i32.const 3)))"


def real_constant(value: float) -> str:
    """A real constant; there is one NaN (decision 58)."""
    return "nan" if value != value else value.hex()

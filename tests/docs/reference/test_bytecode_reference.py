"""The tables of the bytecode page are current and complete."""

from __future__ import annotations

import bytecode_reference

from lfield.bytecode.opcodes import TABLE


def test_bytecode_page_equals_the_opcode_table() -> None:
    page = bytecode_reference.PAGE.read_text(encoding="utf-8")
    assert page == bytecode_reference.page_with_table(page), (
        "run: python tests/docs/reference/bytecode_reference.py --write"
    )


def test_bytecode_page_has_every_instruction() -> None:
    text = bytecode_reference.reference()
    for row in TABLE:
        assert f"| {row.code} | `{row.name}` |" in text

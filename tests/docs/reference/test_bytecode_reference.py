"""The tables of the bytecode page are current and complete."""

from __future__ import annotations

import bytecode_reference

from lfield.bytecode.opcodes import TABLE


def test_the_reference_page_is_that_of_the_table() -> None:
    page = bytecode_reference.PAGE.read_text(encoding="utf-8")
    assert page == bytecode_reference.page_with_table(page), (
        "run: python tests/docs/reference/bytecode_reference.py --write"
    )


def test_the_reference_has_every_instruction() -> None:
    text = bytecode_reference.reference()
    for row in TABLE:
        assert f"| {row.code} | `{row.name}` |" in text

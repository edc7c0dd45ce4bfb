"""The reference of the registry is that of the files, and has all that is in them."""

from __future__ import annotations

from lfield.capability.reading.reader import read_registry
from lfield.operator.registry import reference

REGISTRY = read_registry()


def test_the_page_is_current() -> None:
    assert reference.PAGE.read_text(encoding="utf-8") == reference.page(REGISTRY), (
        "run: python -m lfield.operator.registry.reference --write"
    )


def test_the_page_has_everything() -> None:
    text = reference.page(REGISTRY)
    cells = [*REGISTRY.terms, *REGISTRY.attributes, *REGISTRY.equivalences]
    assert [cell for cell in cells if f"\n| `{cell}` |" not in text] == []
    headings = [*REGISTRY.primitives, *REGISTRY.providers, *REGISTRY.compositions]
    assert [heading for heading in headings if f"\n### {heading}\n" not in text] == []


def test_something_that_we_ship_serves_everything() -> None:
    text = reference.page(REGISTRY)
    unserved = {
        section.partition("\n")[0]
        for section in text.split("\n### ")
        if "Nothing that we ship serves it" in section
    }
    assert unserved == set()

"""The reference page of the registry is current and complete."""

from __future__ import annotations

import capability_reference

from lfield.capability.registry_reader.registry_files import read_registry

REGISTRY = read_registry()


def test_capability_page_is_current() -> None:
    assert capability_reference.PAGE.read_text(encoding="utf-8") == capability_reference.page(REGISTRY), (
        "run: python tests/docs/reference/capability_reference.py --write"
    )


def test_capability_page_has_every_entry() -> None:
    text = capability_reference.page(REGISTRY)
    cells = [*REGISTRY.terms, *REGISTRY.attributes, *REGISTRY.equivalences]
    assert [cell for cell in cells if f"\n| `{cell}` |" not in text] == []
    headings = [*REGISTRY.primitives, *REGISTRY.providers, *REGISTRY.compositions]
    assert [heading for heading in headings if f"\n### {heading}\n" not in text] == []


def test_stock_resource_types_serve_every_primitive() -> None:
    text = capability_reference.page(REGISTRY)
    unserved = {
        section.partition("\n")[0]
        for section in text.split("\n### ")
        if "No stock resource type serves it" in section
    }
    assert unserved == set()

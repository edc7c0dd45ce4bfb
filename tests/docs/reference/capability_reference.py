"""The page lfield/docs/capability-reference.md: the sheets of the registry in `capabilities/`, in Markdown.

`python tests/docs/reference/capability_reference.py` prints it; `--write` writes the page.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TypeVar

from msgspec import structs
from msgspec.structs import replace

from lfield.capability.model import Argument, PortalMap, Provider, Registry, TaxonomyTerm
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.operator.registry import sheets
from lfield.operator.registry.sheets import Sheet, code
from lfield.operator.registry.taxonomy import primitives_of

T = TypeVar("T")

PAGE = Path(__file__).parents[3] / "lfield" / "docs" / "capability-reference.md"

_OPENING = """# Capability reference

The registry that lfield ships. [capabilities.md](capabilities.md) explains how to use and extend it.
[Providers](#providers) has the values of each resource type. `lfield capabilities show NAME` prints one
entry, also with the providers of an attribute and the attributes of a primitive. This page is generated
from `capabilities/`: `python tests/docs/reference/capability_reference.py --write`."""

_SAME = "A portal without a line is mapped to the portal of the same name, with the same parameters.\n\n"

#: Rows whose content is also in the taxonomy, the providers or the rules.
_REPEATED = {"id", "stated by", "attributes", "serves"}


def page(registry: Registry) -> str:
    """The whole page in Markdown."""
    attributes, primitives = _sorted(registry.attributes), _sorted(registry.primitives)
    sections = {
        f"Taxonomy, version {registry.version}": _table(_term(registry, t) for t in registry.terms.values()),
        "Attributes": _table(_brief(sheets.attribute_sheet(registry, a)) for a in attributes),
        "Primitives": _chapters(_brief(sheets.primitive_sheet(registry, p)) for p in primitives),
        "Providers": _SAME
        + _chapters(
            sheets.provider_sheet(registry, _mapped(registry, p)) for p in _sorted(registry.providers)
        ),
        "One-to-one": _table(map(sheets.equivalence_sheet, _sorted(registry.equivalences))),
        "One-to-many": _chapters(map(sheets.composition_sheet, _sorted(registry.compositions))),
    }
    return "\n\n".join([_OPENING, *(f"## {title}\n\n{text}" for title, text in sections.items())]) + "\n"


def _sorted(found: Mapping[str, T]) -> list[T]:
    return [found[name] for name in sorted(found)]


def _term(registry: Registry, term: TaxonomyTerm) -> Sheet:
    """A term with its primitives. The terms below it are the next rows. A name equal to the id is omitted."""
    sheet = sheets.term_sheet(registry, term)
    called = tuple(map(code, primitives_of(registry, term.id)))
    plain = term.id.rpartition(".")[2].replace("_", " ")
    omitted = {"below", "name"} if term.name.casefold() == plain else {"below"}
    return replace(sheet, rows=(*(row for row in sheet.rows if row[0] not in omitted), ("called as", called)))


def _mapped(registry: Registry, provider: Provider) -> Provider:
    """A provider without the portals that are mapped to themselves."""

    def is_same(primitive: str, mapped: PortalMap) -> bool:
        parameters = registry.primitives[primitive].portals[mapped.portal].parameters
        same = tuple(Argument(parameter.name) for parameter in parameters)
        return mapped.target == mapped.portal and mapped.arguments == same and mapped.result is None

    serves = {
        name: structs.replace(
            served, portals={key: m for key, m in served.portals.items() if not is_same(served.primitive, m)}
        )
        for name, served in provider.serves.items()
    }
    return structs.replace(provider, serves=serves)


def _brief(sheet: Sheet) -> Sheet:
    return replace(sheet, rows=tuple(row for row in sheet.rows if row[0] not in _REPEATED))


def _table(found: Iterable[Sheet]) -> str:
    """Sheets as the rows of a table, with a column for each label of a sheet."""
    rows = {sheet.name: dict(sheet.rows) for sheet in found}
    labels = list(dict.fromkeys(label for row in rows.values() for label in row))
    cells = [["name" if "name" not in labels else "id", *labels], ["---"] * (1 + len(labels))]
    cells += [
        [code(name), *("; ".join(row.get(label, ())) for label in labels)] for name, row in rows.items()
    ]
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in cells)


def _chapters(found: Iterable[Sheet]) -> str:
    return "\n\n".join("\n".join([f"### {sheet.name}", "", *_list(sheet)]) for sheet in found)


def _list(sheet: Sheet) -> Iterator[str]:
    """A list item for each row: its lines are joined by `;`, or are a nested list if some are indented."""
    for label, lines in sheet.rows:
        if not any(line.startswith("    ") for line in lines):
            yield f"- {label}: {'; '.join(lines)}"
            continue
        yield f"- {label}:"
        for line in lines:
            inner = line.lstrip(" ")
            yield f"{'    ' if inner != line else '  '}- {inner}"


def main() -> None:
    """Print the page, or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.name}")
    text = page(read_registry())
    if parser.parse_args().write:
        PAGE.write_text(text, encoding="utf-8")
    else:
        print(text, end="")


if __name__ == "__main__":
    main()

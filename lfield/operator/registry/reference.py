"""The page docs/capability-reference.md, made from the registry that we ship.

`python -m lfield.operator.registry.reference` prints it; with `--write` it is put into its place.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from lfield.capability.model import (
    Attribute,
    Composition,
    Equivalence,
    Portal,
    PortalMap,
    Primitive,
    Provider,
    Registry,
    Served,
    Term,
    Value,
)
from lfield.capability.reading.reader import read_registry
from lfield.operator.registry.words import call, signature, with_unit, worth

PAGE = Path(__file__).parents[2] / "docs" / "capability-reference.md"

_OPENING = """# Capability reference

What the registry holds that comes with lfield. [capabilities.md](capabilities.md) says how it is used and
extended. It is written from `capabilities/` by `python -m lfield.operator.registry.reference --write`."""


def page(registry: Registry) -> str:
    """The whole page in Markdown."""
    sections = (
        _taxonomy(registry),
        _attributes(registry.attributes.values()),
        _primitives(registry),
        _providers(registry),
        _equivalences(registry.equivalences.values()),
        _compositions(registry.compositions.values()),
    )
    return "\n".join([_OPENING, *(line for section in sections for line in section), ""]).replace(
        "\n\n\n", "\n\n"
    )


# --- terms and attributes -----------------------------------------------------------------------------


def _taxonomy(registry: Registry) -> Iterator[str]:
    callable_as: dict[str, list[str]] = {}
    for primitive in registry.primitives.values():
        callable_as.setdefault(primitive.id, []).append(primitive.name)
    yield from _heading(f"Taxonomy, version {registry.version}")
    yield from _table(
        ("id", "name", "meaning", "called as"),
        (_term(term, callable_as.get(term.id, [])) for term in registry.terms.values()),
    )


def _term(term: Term, called: Iterable[str]) -> tuple[str, ...]:
    notes = [f"also {_code(alias)}" for alias in term.aliases]
    if term.deprecated:
        notes.append(f"out of use, write {_code(term.deprecated)}")
    return _code(term.id), term.name, "; ".join([term.meaning, *notes]), ", ".join(map(_code, called))


def _attributes(attributes: Iterable[Attribute]) -> Iterator[str]:
    yield from _heading("Attributes")
    yield from _table(
        ("name", "type", "unit", "better", "typical", "meaning"),
        map(_attribute, sorted(attributes, key=_name)),
    )


def _attribute(attribute: Attribute) -> tuple[str, ...]:
    ranked = attribute.better != "none"
    notes = [attribute.meaning]
    if attribute.values:
        notes.append("one of " + ", ".join(map(_code, attribute.values)))
    if attribute.live:
        notes.append(f"live, counts for {attribute.max_age:g} s")
    return (
        _code(attribute.name),
        attribute.type,
        attribute.unit,
        attribute.better if ranked else "",
        f"{attribute.typical:g}" if ranked else "",
        "; ".join(notes),
    )


# --- primitives ---------------------------------------------------------------------------------------


def _primitives(registry: Registry) -> Iterator[str]:
    yield from _heading("Primitives")
    for primitive in sorted(registry.primitives.values(), key=_name):
        yield from _primitive(registry, primitive)


def _primitive(registry: Registry, primitive: Primitive) -> Iterator[str]:
    yield from _heading(primitive.name, 3)
    yield f"{_code(primitive.id)}: {primitive.meaning}. {_served_by(registry, primitive.name)}"
    yield ""
    yield from _table(
        ("portal", "parameters", "emits", "effect", "raises", "meaning"),
        map(_portal, primitive.portals.values()),
    )


def _served_by(registry: Registry, primitive: str) -> str:
    types = [p.type for p in registry.providers.values() if primitive in p.serves]
    rules = [r.name for r in registry.equivalences.values() if r.serves == primitive]
    rules += [r.name for r in registry.compositions.values() if r.serves == primitive]
    if not types and not rules:
        return "Nothing that we ship serves it: a mission's own resource types may."
    return f"Served by {', '.join([*sorted(types), *map(_code, sorted(rules))])}."


def _portal(portal: Portal) -> tuple[str, ...]:
    parameters = (": ".join(filter(None, (with_unit(p.name, p.unit), p.meaning))) for p in portal.parameters)
    emitted = "" if portal.result == "void" else with_unit(portal.result, portal.unit)
    return (
        _code(signature(portal)),
        "; ".join(parameters),
        emitted,
        portal.effect,
        ", ".join(portal.raises),
        portal.meaning,
    )


# --- providers ----------------------------------------------------------------------------------------


def _providers(registry: Registry) -> Iterator[str]:
    yield from _heading("Providers")
    for provider in sorted(registry.providers.values(), key=lambda p: p.type):
        yield from _provider(registry, provider)


def _provider(registry: Registry, provider: Provider) -> Iterator[str]:
    yield from _heading(provider.type, 3)
    yield f"{_code(f'include <{provider.include}>;')} {provider.meaning}."
    yield ""
    yield f"- states: {_values(registry, provider.attributes)}"
    yield f"- tells: {', '.join(sorted(provider.live))}"
    yield ""
    yield from _table(
        ("serves", "when", "by calling", "states besides"),
        (_served(registry, provider, served) for served in provider.serves.values()),
    )


def _served(registry: Registry, provider: Provider, served: Served) -> tuple[str, ...]:
    return (
        served.primitive,
        _code(served.when.text) if served.when is not None else "",
        _calls(provider.type, served.portals),
        _values(registry, served.attributes),
    )


def _values(registry: Registry, values: Mapping[str, Value]) -> str:
    return ", ".join(
        f"{name} {worth(value, registry.attributes[name].unit)}" for name, value in values.items()
    )


# --- rules --------------------------------------------------------------------------------------------


def _equivalences(rules: Iterable[Equivalence]) -> Iterator[str]:
    yield from _heading("One-to-one")
    yield from _table(
        ("rule", "serves", "by calling", "when", "loss", "meaning"),
        (
            (
                _code(rule.name),
                rule.serves,
                _calls(rule.by, rule.portals),
                _code(rule.when.text) if rule.when is not None else "",
                f"{rule.loss:g}",
                rule.meaning,
            )
            for rule in sorted(rules, key=_name)
        ),
    )


def _compositions(rules: Iterable[Composition]) -> Iterator[str]:
    yield from _heading("One-to-many")
    for rule in sorted(rules, key=_name):
        yield from _heading(rule.name, 3)
        yield f"{rule.serves}: {rule.meaning}. Loss {rule.loss:g}; the class is {_code(rule.through)}."
        yield ""
        for need in rule.needs.values():
            condition = f", with {_code(need.when.text)}" if need.when is not None else ""
            yield f"- needs {_code(need.name)}: {need.primitive}{condition}"
        yield from (f"- where {_code(condition.text)}" for condition in rule.where)
        yield from (f"- {name} is {_code(worth.text)}" for name, worth in rule.attributes.items())


# --- pieces -------------------------------------------------------------------------------------------


def _calls(target: str, portals: Mapping[str, PortalMap]) -> str:
    """`Winch.lift(height)`, with what the caller gets instead of what that emits."""
    return ", ".join(_code(call(target, mapped)) for mapped in portals.values())


def _name(named: Attribute | Primitive | Equivalence | Composition) -> str:
    return named.name


def _code(text: str) -> str:
    return f"`{text}`"


def _heading(text: str, level: int = 2) -> tuple[str, ...]:
    return "", f"{'#' * level} {text}", ""


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    for cells in (head, ("---",) * len(head), *rows):
        yield f"| {' | '.join(_cell(cell) for cell in cells)} |"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def main(arguments: list[str] | None = None) -> None:
    """Print the page, or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.name}")
    text = page(read_registry())
    if parser.parse_args(arguments).write:
        PAGE.write_text(text, encoding="utf-8")
    else:
        print(text, end="")


if __name__ == "__main__":
    main()

"""What a registry says, for people at a terminal: the taxonomy as a tree, one name on a sheet."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from lfield.capability.model import (
    Attribute,
    Composition,
    Equivalence,
    Portal,
    Primitive,
    Provider,
    Registry,
    Served,
    Term,
    Value,
)
from lfield.operator.registry.words import call, signature, with_unit, worth
from lfield.text.suggest import did_you_mean, listed


@dataclass(frozen=True, slots=True)
class Branch:
    """A line of a tree with what hangs below it. `mark` is the L type of what can be called."""

    text: str
    children: tuple[Branch, ...] = ()
    mark: str = ""


@dataclass(frozen=True, slots=True)
class Sheet:
    """What there is to say about one name: rows of a label and its lines, none of them empty."""

    title: str
    rows: tuple[tuple[str, tuple[str, ...]], ...]


#: What may get onto a sheet: labels with their lines, empty ones included.
_Rows = list[tuple[str, Iterable[str]]]


# --- names --------------------------------------------------------------------------------------------


def term_of(registry: Registry, id: str) -> Term | None:
    """The term of an id. Aliases and ids out of use lead to the one that counts."""
    term = registry.terms.get(id)
    if term is None:
        term = next((t for t in registry.terms.values() if id in t.aliases), None)
    return registry.terms[term.deprecated] if term is not None and term.deprecated else term


def primitives_below(registry: Registry, id: str) -> list[Primitive]:
    """The primitives that can be called at a term or below it, in the order of their ids and names."""
    found = [p for p in registry.primitives.values() if is_below(p.id, id)]
    return sorted(found, key=lambda p: (p.id, p.name))


def is_below(id: str, above: str) -> bool:
    """Whether an id is another one, or stands below it in the tree."""
    return id == above or id.startswith(f"{above}.")


def unknown_name(registry: Registry, word: str) -> str:
    """A hint about a name that nothing in the registry has."""
    known = (
        registry.terms,
        registry.primitives,
        registry.attributes,
        registry.providers,
        registry.equivalences,
        registry.compositions,
    )
    hint = did_you_mean(word[:80], [name for names in known for name in names])
    return hint or "'lfield capabilities tree' shows what there is"


# --- the tree -----------------------------------------------------------------------------------------


def tree(registry: Registry, id: str = "") -> list[Branch]:
    """The taxonomy, or what hangs at one of its terms; deprecated terms say what to write instead."""
    roots = [registry.terms[id]] if id else [t for t in registry.terms.values() if "." not in t.id]
    return [_branch(registry, term, term.id) for term in roots]


def _branch(registry: Registry, term: Term, name: str) -> Branch:
    called = sorted(p.name for p in registry.primitives.values() if p.id == term.id)
    said = f"out of use, write {term.deprecated}" if term.deprecated else term.meaning
    below = tuple(_branch(registry, child, child.id.rpartition(".")[2]) for child in _below(registry, term))
    return Branch(f"{name}: {said}" if said else name, below, ", ".join(called))


def _below(registry: Registry, term: Term) -> list[Term]:
    return [t for t in registry.terms.values() if t.id.rpartition(".")[0] == term.id]


# --- sheets -------------------------------------------------------------------------------------------


def describe(registry: Registry, word: str) -> list[Sheet]:
    """Everything that has this name or id, or this word of the thesis; [] when nothing does."""
    named = word.casefold()
    terms = [t for t in registry.terms.values() if named in (t.name.casefold(), t.id)]
    if (meant := term_of(registry, word)) is not None and meant not in terms:
        terms.append(meant)
    if word in registry.primitives:
        terms.append(registry.terms[registry.primitives[word].id])
    sheets = []
    for term in dict.fromkeys(term.id for term in terms):
        sheets.append(_term_sheet(registry, registry.terms[term]))
        called = sorted(p.name for p in registry.primitives.values() if p.id == term)
        sheets += [_primitive_sheet(registry, registry.primitives[name]) for name in called]
    if word in registry.attributes:
        sheets.append(_attribute_sheet(registry, registry.attributes[word]))
    if word in registry.providers:
        sheets.append(_provider_sheet(registry, registry.providers[word]))
    if word in registry.equivalences:
        sheets.append(_equivalence_sheet(registry.equivalences[word]))
    if word in registry.compositions:
        sheets.append(_composition_sheet(registry.compositions[word]))
    return sheets


def _sheet(title: str, rows: _Rows) -> Sheet:
    """A sheet without what has nothing to say."""
    said = ((label, tuple(line for line in lines if line)) for label, lines in rows)
    return Sheet(title, tuple((label, lines) for label, lines in said if lines))


def _term_sheet(registry: Registry, term: Term) -> Sheet:
    rows: _Rows = [
        ("name", [term.name]),
        ("meaning", [term.meaning]),
        ("also", term.aliases),
        ("instead", [term.deprecated]),
        ("below", [child.id for child in _below(registry, term)]),
    ]
    return _sheet(f"term {term.id}", rows)


def _primitive_sheet(registry: Registry, primitive: Primitive) -> Sheet:
    name = primitive.name
    rows: _Rows = [
        ("id", [primitive.id]),
        ("meaning", [primitive.meaning]),
        ("portals", [line for portal in primitive.portals.values() for line in _portal(portal)]),
        ("served by", _served_by(registry, name)),
        ("serves", _serves_too(registry, name)),
        ("attributes", [_attributes_of(registry, name)]),
    ]
    return _sheet(f"primitive {name}", rows)


def _portal(portal: Portal) -> Iterator[str]:
    """The signature, then what the parameters and the result mean, and what can go wrong."""
    yield signature(portal)
    if portal.meaning:
        yield f"    {portal.meaning}"
    for parameter in portal.parameters:
        said = ", ".join(filter(None, (parameter.unit, parameter.meaning)))
        if said:
            yield f"    {parameter.name}: {said}"
    if portal.unit:
        yield f"    emits {portal.unit}"
    yield f"    {portal.effect}" + (f", raises {listed(portal.raises)}" if portal.raises else "")


def _served_by(registry: Registry, primitive: str) -> Iterator[str]:
    for type, provider in sorted(registry.providers.items()):
        if primitive in provider.serves:
            yield f"{type}{_when(provider.serves[primitive])}"
    for name, rule in sorted(registry.equivalences.items()):
        if rule.serves == primitive:
            yield f"{name}: whoever serves {rule.by}{_when(rule)}, loss {rule.loss:g}"
    for name, whole in sorted(registry.compositions.items()):
        if whole.serves == primitive:
            needs = listed(f"{need.primitive} ({need.name})" for need in whole.needs.values())
            yield f"{name}: {needs} together, loss {whole.loss:g}"


def _serves_too(registry: Registry, primitive: str) -> Iterator[str]:
    """What else the primitive is good for."""
    for name, rule in sorted(registry.equivalences.items()):
        if rule.by == primitive:
            yield f"{rule.serves}, by {name}"
    for name, whole in sorted(registry.compositions.items()):
        if any(need.primitive == primitive for need in whole.needs.values()):
            yield f"{whole.serves}, as a part of {name}"


def _attributes_of(registry: Registry, primitive: str) -> str:
    """The attributes that anybody who serves it states or tells."""
    found: set[str] = set()
    for provider in registry.providers.values():
        if primitive in provider.serves:
            found.update(provider.attributes, provider.live, provider.serves[primitive].attributes)
    units = {name: registry.attributes[name].unit for name in sorted(found) if name in registry.attributes}
    return ", ".join(f"{name} ({unit})" if unit else name for name, unit in units.items())


def _attribute_sheet(registry: Registry, attribute: Attribute) -> Sheet:
    rated = attribute.better != "none"
    rows: _Rows = [
        ("meaning", [attribute.meaning]),
        ("type", [with_unit(attribute.type, f"in {attribute.unit}" if attribute.unit else "")]),
        ("values", [", ".join(attribute.values)]),
        ("better", [attribute.better] if rated else []),
        ("typical", [worth(attribute.typical, attribute.unit)] if rated else []),
        ("live", [f"counts for {attribute.max_age:g} s"] if attribute.live else []),
        ("stated by", _stated_by(registry, attribute)),
    ]
    return _sheet(f"attribute {attribute.name}", rows)


def _stated_by(registry: Registry, attribute: Attribute) -> Iterator[str]:
    name, unit = attribute.name, attribute.unit
    for type, provider in sorted(registry.providers.items()):
        if name in provider.attributes:
            yield f"{type}: {worth(provider.attributes[name], unit)}"
        if name in provider.live:
            live = provider.live[name]
            yield f"{type}: live, {live.device}.{live.quantity}"
        for served in provider.serves.values():
            if name in served.attributes:
                yield f"{type}, for {served.primitive}: {worth(served.attributes[name], unit)}"
    for agent, values in registry.agents.items():
        if name in values:
            yield f"agent {agent}: {worth(values[name], unit)}"


def _provider_sheet(registry: Registry, provider: Provider) -> Sheet:
    live = (f"{name}: {x.device}.{x.quantity}{_index(x.index)}" for name, x in provider.live.items())
    rows: _Rows = [
        ("meaning", [provider.meaning]),
        ("source", [f"include <{provider.include}>;" if provider.include else "the mission's own"]),
        ("states", _values(registry, provider.attributes)),
        ("tells", live),
        ("serves", [line for s in provider.serves.values() for line in _served(registry, provider, s)]),
    ]
    return _sheet(f"provider {provider.type}", rows)


def _index(index: int | None) -> str:
    return "" if index is None else f"[{index}]"


def _served(registry: Registry, provider: Provider, served: Served) -> Iterator[str]:
    yield f"{served.primitive}{_when(served)}"
    for mapped in served.portals.values():
        yield f"    {mapped.portal}: {call(provider.type, mapped)}"
    for line in _values(registry, served.attributes):
        yield f"    {line}"


def _values(registry: Registry, values: Mapping[str, Value]) -> Iterator[str]:
    for name, value in values.items():
        yield f"{name}: {worth(value, registry.attributes[name].unit)}"


def _equivalence_sheet(rule: Equivalence) -> Sheet:
    rows: _Rows = [
        ("meaning", [rule.meaning]),
        ("serves", [rule.serves]),
        ("by", [rule.by]),
        ("when", [rule.when.text] if rule.when is not None else []),
        ("portals", [f"{m.portal}: {call(rule.by, m)}" for m in rule.portals.values()]),
        ("loss", [f"{rule.loss:g}"]),
    ]
    return _sheet(f"one-to-one rule {rule.name}", rows)


def _composition_sheet(rule: Composition) -> Sheet:
    needs = [
        f"{need.name}: {need.primitive}" + (f" when {need.when.text}" if need.when is not None else "")
        for need in rule.needs.values()
    ]
    rows: _Rows = [
        ("meaning", [rule.meaning]),
        ("serves", [rule.serves]),
        ("needs", needs),
        ("where", [condition.text for condition in rule.where]),
        ("states", [f"{name}: {e.text}" for name, e in rule.attributes.items()]),
        ("through", [f"class {rule.through} in {rule.source.name}"]),
        ("loss", [f"{rule.loss:g}"]),
    ]
    return _sheet(f"one-to-many rule {rule.name}", rows)


def _when(rule: Served | Equivalence) -> str:
    return f" when {rule.when.text}" if rule.when is not None else ""

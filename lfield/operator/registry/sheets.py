"""The entry of one name of a registry as text: for a terminal, or in Markdown (reference.py).

Code is in backticks, which a terminal does not show. A line that begins with four spaces belongs to the one
above.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping

from msgspec import Struct

from lfield.capability.model import (
    Argument,
    Attribute,
    Composition,
    Equivalence,
    Expression,
    LiveAttribute,
    Portal,
    PortalMap,
    Primitive,
    Provider,
    Registry,
    ServedPrimitive,
    TaxonomyTerm,
    Value,
)
from lfield.capability.registry_reader.unit_signatures import written
from lfield.operator.registry.taxonomy import primitives_of, term_of, terms_below
from lfield.text.suggestions import listed


class Sheet(Struct, frozen=True):
    """The description of one name: rows of a label and its lines, none of them empty."""

    kind: str
    name: str
    rows: tuple[tuple[str, tuple[str, ...]], ...]


def describe(registry: Registry, name_or_id: str) -> list[Sheet]:
    """The sheets of all entries with this name or id, or this word of the thesis; [] for none."""
    named = name_or_id.casefold()
    terms = [t.id for t in registry.terms.values() if named in (t.name.casefold(), t.id)]
    if (meant := term_of(registry, name_or_id)) is not None:
        terms.append(meant.id)
    if name_or_id in registry.primitives:
        terms.append(registry.primitives[name_or_id].id)
    sheets = []
    for id in dict.fromkeys(terms):
        sheets.append(term_sheet(registry, registry.terms[id]))
        called = primitives_of(registry, id)
        sheets += [primitive_sheet(registry, registry.primitives[name]) for name in called]
    if name_or_id in registry.attributes:
        sheets.append(attribute_sheet(registry, registry.attributes[name_or_id]))
    if name_or_id in registry.providers:
        sheets.append(provider_sheet(registry, registry.providers[name_or_id]))
    if name_or_id in registry.equivalences:
        sheets.append(equivalence_sheet(registry.equivalences[name_or_id]))
    if name_or_id in registry.compositions:
        sheets.append(composition_sheet(registry.compositions[name_or_id]))
    return sheets


def in_terminal(sheet: Sheet) -> Iterator[str]:
    """The lines of a sheet, labels on the left."""
    width = max((len(label) for label, _ in sheet.rows), default=0)
    yield f"{sheet.kind} {sheet.name}"
    for label, lines in sheet.rows:
        for number, line in enumerate(lines):
            yield f"  {label if number == 0 else '':{width}}  {line.replace('`', '')}"


def _sheet(kind: str, name: str, rows: Mapping[str, Iterable[str] | str]) -> Sheet:
    """A sheet without empty rows."""
    sections = (
        (label, tuple(line for line in ([lines] if isinstance(lines, str) else lines) if line))
        for label, lines in rows.items()
    )
    return Sheet(kind, name, tuple((label, lines) for label, lines in sections if lines))


# --- terms and attributes -----------------------------------------------------------------------------


def term_sheet(registry: Registry, term: TaxonomyTerm) -> Sheet:
    """A node of the taxonomy."""
    rows = {
        "name": term.name,
        "meaning": term.meaning,
        "also": map(code, term.aliases),
        "instead": code(term.deprecated),
        "below": [code(child.id) for child in terms_below(registry, term.id)],
    }
    return _sheet("term", term.id, rows)


def attribute_sheet(registry: Registry, attribute: Attribute) -> Sheet:
    """An attribute: its values, and the providers that state it."""
    rated = attribute.better != "none"
    rows = {
        "meaning": attribute.meaning,
        "type": with_unit(attribute.type, f"in {attribute.unit}" if attribute.unit else ""),
        "values": ", ".join(map(code, attribute.values)),
        "better": attribute.better if rated else "",
        "typical": value_text(attribute.typical, attribute.unit) if rated else "",
        "live": f"counts for {attribute.max_age:g} s" if attribute.live else "",
        "stated by": _stated_by(registry, attribute),
    }
    return _sheet("attribute", attribute.name, rows)


def _stated_by(registry: Registry, attribute: Attribute) -> Iterator[str]:
    """A line for each provider, capability of a provider, and agent that has a value of the attribute."""
    name, unit = attribute.name, attribute.unit
    for type, provider in sorted(registry.providers.items()):
        if name in provider.attributes:
            yield f"{type}: {value_text(provider.attributes[name], unit)}{_usual(name, provider.nominal)}"
        if name in provider.live:
            yield f"{type}: {'live' if attribute.live else 'reported'}, {_source(provider.live[name])}"
        for served in provider.serves.values():
            if name in served.attributes:
                text = f"{value_text(served.attributes[name], unit)}{_usual(name, served.nominal)}"
                yield f"{type}, for {served.primitive}: {text}"
    for agent, values in registry.agents.items():
        if name in values:
            yield f"agent {agent}: {value_text(values[name], unit)}"


# --- primitives ---------------------------------------------------------------------------------------


def primitive_sheet(registry: Registry, primitive: Primitive) -> Sheet:
    """A primitive: its portals, its providers, and the primitives that it serves."""
    no_provider = ["No stock resource type serves it; a mission's own types may."]
    rows = {
        "id": code(primitive.id),
        "meaning": primitive.meaning,
        "portals": [line for portal in primitive.portals.values() for line in _portal(portal)],
        "served by": list(_served_by(registry, primitive.name)) or no_provider,
        "serves": _serves_too(registry, primitive.name),
        "attributes": _attributes_of(registry, primitive.name),
    }
    return _sheet("primitive", primitive.name, rows)


def _portal(portal: Portal) -> Iterator[str]:
    """The signature of a portal, the meaning of its parameters and result, and its exceptions."""
    yield code(written(portal.name, [f"{p.type} {p.name}" for p in portal.parameters], portal.result))
    if portal.meaning:
        yield f"    {portal.meaning}"
    for parameter in portal.parameters:
        description = ", ".join(filter(None, (parameter.unit, parameter.meaning)))
        if description:
            yield f"    {parameter.name}: {description}"
    if portal.unit:
        yield f"    emits {portal.unit}"
    yield f"    {portal.effect}" + (f", raises {listed(portal.raises)}" if portal.raises else "")


def _served_by(registry: Registry, primitive: str) -> Iterator[str]:
    for type, provider in sorted(registry.providers.items()):
        if primitive in provider.serves:
            yield f"{type}{_when(provider.serves[primitive].when)}"
    for name, rule in sorted(registry.equivalences.items()):
        if rule.serves == primitive:
            yield f"{code(name)}: every provider of {rule.by}{_when(rule.when)}, loss {rule.loss:g}"
    for name, whole in sorted(registry.compositions.items()):
        if whole.serves == primitive:
            needs = listed(f"{need.primitive} ({need.name})" for need in whole.needs.values())
            yield f"{code(name)}: {needs} together, loss {whole.loss:g}"


def _serves_too(registry: Registry, primitive: str) -> Iterator[str]:
    """Further uses of a primitive, by the rules."""
    for name, rule in sorted(registry.equivalences.items()):
        if rule.by == primitive:
            yield f"{rule.serves}, by {code(name)}"
    for name, whole in sorted(registry.compositions.items()):
        if any(need.primitive == primitive for need in whole.needs.values()):
            yield f"{whole.serves}, as a part of {code(name)}"


def _attributes_of(registry: Registry, primitive: str) -> str:
    """The attributes that any provider states or reports."""
    found: set[str] = set()
    for provider in registry.providers.values():
        if primitive in provider.serves:
            found.update(provider.attributes, provider.live, provider.serves[primitive].attributes)
    units = {name: registry.attributes[name].unit for name in sorted(found)}
    return ", ".join(f"{name} ({unit})" if unit else name for name, unit in units.items())


# --- providers ----------------------------------------------------------------------------------------


def provider_sheet(registry: Registry, provider: Provider) -> Sheet:
    """A resource type: the attributes that it states and reports, and the primitives that it serves."""
    stated = {name: value for name, value in provider.attributes.items() if name not in provider.nominal}
    nominal = {name: value for name, value in provider.attributes.items() if name in provider.nominal}
    rows = {
        "meaning": provider.meaning,
        "source": code(f"include <{provider.include}>;") if provider.include else "the mission's own",
        "states": _values(registry, stated, ()),
        "nominal": _values(registry, nominal, ()),
        "reports": [f"{name}: {_source(live)}" for name, live in provider.live.items()],
        "serves": [line for s in provider.serves.values() for line in _served(registry, provider, s)],
    }
    return _sheet("provider", provider.type, rows)


def _source(live: LiveAttribute) -> str:
    index = "" if live.index is None else f"[{live.index}]"
    return code(f"{live.portal}(){index}" if live.portal else f"{live.device}.{live.quantity}{index}")


def _served(registry: Registry, provider: Provider, served: ServedPrimitive) -> Iterator[str]:
    yield f"{served.primitive}{_when(served.when)}"
    for mapped in served.portals.values():
        yield f"    {mapped.portal}: {_call(provider.type, mapped)}"
    for line in _values(registry, served.attributes, served.nominal):
        yield f"    {line}"


def _values(registry: Registry, values: Mapping[str, Value], nominal: Collection[str]) -> Iterator[str]:
    for name, value in values.items():
        yield f"{name}: {value_text(value, registry.attributes[name].unit)}{_usual(name, nominal)}"


def _usual(name: str, nominal: Collection[str]) -> str:
    return ", nominal" if name in nominal else ""


# --- rules --------------------------------------------------------------------------------------------


def equivalence_sheet(rule: Equivalence) -> Sheet:
    """A one-to-one rule."""
    rows = {
        "meaning": rule.meaning,
        "serves": rule.serves,
        "by": rule.by,
        "when": code(rule.when.text) if rule.when is not None else "",
        "portals": [f"{m.portal}: {_call(rule.by, m)}" for m in rule.portals.values()],
        "loss": f"{rule.loss:g}",
    }
    return _sheet("one-to-one rule", rule.name, rows)


def composition_sheet(rule: Composition) -> Sheet:
    """A one-to-many rule."""
    rows = {
        "meaning": rule.meaning,
        "serves": rule.serves,
        "needs": [f"{need.name}: {need.primitive}{_when(need.when)}" for need in rule.needs.values()],
        "where": [code(condition.text) for condition in rule.where],
        "states": [f"{name}: {code(e.text)}" for name, e in rule.attributes.items()],
        "through": f"class {code(rule.through)} in {rule.source.name}",
        "loss": f"{rule.loss:g}",
    }
    return _sheet("one-to-many rule", rule.name, rows)


def _when(condition: Expression | None) -> str:
    return f" when {code(condition.text)}" if condition is not None else ""


def _call(target: str, mapped: PortalMap) -> str:
    """A mapped call; the results of the caller replace those of the callee: `Winch.lift(height) ->
    height`.
    """
    text = f"{target}.{mapped.target}({', '.join(map(_argument, mapped.arguments))})"
    return code(text if mapped.result is None else f"{text} -> {_argument(mapped.result)}")


def _argument(argument: Argument) -> str:
    if argument.parameter:
        text = argument.parameter
    elif argument.constant is None:
        text = "emitted"
    else:
        constant = value_text(argument.constant)
        text = f'"{constant}"' if isinstance(argument.constant, str) and argument.constant else constant
    if argument.factor != 1:
        text += f" * {argument.factor:g}"
    return text + (f" + {argument.offset:g}" if argument.offset else "")


# --- words --------------------------------------------------------------------------------------------


def code(text: str) -> str:
    """A text as code; '' stays empty."""
    return f"`{text}`" if text else ""


def printable(text: str) -> str:
    """A text on one line; control characters of a terminal are shown as dots."""
    return "".join(ch if ch.isprintable() else "·" for ch in text)


def value_text(value: Value, unit: str = "") -> str:
    """A value with its unit: `2.5 kg`, `aerial and terrestrial`, `true`."""
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            return printable(value) or '""'
        case frozenset():
            return printable(listed(sorted(value), "nothing"))
        case _:
            return with_unit(f"{value:g}", unit)


def with_unit(text: str, unit: str) -> str:
    """A text with a unit behind it, if there is one."""
    return f"{text} {unit}" if unit else text

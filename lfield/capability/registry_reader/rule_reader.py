"""The section `equivalences`: substitutions of primitives by one other or by several together.

```yaml
equivalences:
  climb-lifts:                       # one-to-one: has `by`
    serves: Lift
    by: Climb
    portals: {lift: {portal: climb, arguments: [height], emit: {parameter: height}}}
    when: "payload >= 0.2"
    loss: 0.3
  grip-and-climb:                    # one-to-many: has `needs`
    serves: Lift
    needs: {grip: {capability: Grip, when: "payload >= 0.1"}, climb: {capability: Climb}}
    where: ["grip.robot != climb.robot"]
    distinct: [grip, climb]          # or true: no agent is two of them
    through: GripAndClimb            # the class in L, in the file `source`, relative to this one
    source: L/grip_and_climb.L
    attributes: {payload: "min(grip.payload, climb.payload)"}
    loss: 0.5
```
A mission may replace a built-in rule by one of the same name. Rules from a specific term to a more general
one are derived from the taxonomy.
"""

from __future__ import annotations

import os.path
from collections.abc import Iterable, Mapping
from pathlib import Path

from lfield.capability.matching.condition_checker import NameScope
from lfield.capability.model import Composition, Equivalence, Expression, Need, Primitive
from lfield.capability.registry_reader import messages
from lfield.capability.registry_reader.attribute_values import read_attribute_expression, read_expression
from lfield.capability.registry_reader.portal_mapping import read_portals, same_name
from lfield.capability.registry_reader.registry_builder import NAME, RULE, TYPE_NAME, RegistryBuilder
from lfield.capability.registry_reader.rule_checks import check_calls
from lfield.capability.registry_reader.unit_signatures import same_call
from lfield.text.source_text import Span
from lfield.text.suggestions import listed
from lfield.text.yaml_fields import YamlFields
from lfield.text.yaml_source import YamlEntry, YamlList, YamlScalar

#: Most parts that a composition can have: the number of combinations grows with each of them.
MAX_NEEDS = 8


def read_rules(builder: RegistryBuilder) -> None:
    """All rules of all files."""
    spans: dict[str, Span] = {}
    for file, entry, fields in builder.entries("equivalences"):
        name = entry.key
        builder.check_name(name, RULE, "a rule", entry.key_span)
        if name in spans and not file.mission:
            builder.report_duplicate("the rule", name, entry.key_span, spans[name])
            continue
        spans[name] = entry.key_span
        builder.equivalences.pop(name, None)
        builder.compositions.pop(name, None)
        _read_rule(builder, entry, fields, file.path.parent)


def _read_rule(builder: RegistryBuilder, entry: YamlEntry, fields: YamlFields, folder: Path) -> None:
    serves = builder.primitive(fields.text("serves", required=True), fields.value_span("serves"))
    if ("by" in fields) == ("needs" in fields):
        builder.report(messages.NEITHER_NOR, entry.key_span, name=entry.key)
    elif serves is None:
        pass  # no part of the rule could be checked
    elif "by" in fields:
        _one_to_one(builder, entry, fields, serves)
    else:
        builder.compositions[entry.key] = _one_to_many(builder, entry, fields, serves, folder)


def _one_to_one(builder: RegistryBuilder, entry: YamlEntry, fields: YamlFields, serves: Primitive) -> None:
    by = builder.primitive(fields.text("by", required=True), fields.value_span("by"))
    if by is serves:
        builder.report(messages.SERVES_ITSELF, fields.value_span("by"), primitive=serves.name)
    portals = read_portals(builder, fields, serves, entry.key_span)
    rule = Equivalence(
        name=entry.key,
        serves=serves.name,
        by=by.name if by is not None else "",
        portals=portals,
        when=read_expression(builder, fields.node("when"), NameScope.of_offer(builder.attributes), "boolean"),
        loss=fields.number("loss", minimum=0.0, maximum=1.0),
        meaning=fields.text("meaning"),
        span=entry.key_span,
    )
    fields.report_unread()
    if by is not None:
        check_calls(builder, rule, serves, by)
        builder.equivalences[entry.key] = rule


def _one_to_many(
    builder: RegistryBuilder, entry: YamlEntry, fields: YamlFields, serves: Primitive, folder: Path
) -> Composition:
    stated, worth = fields.section("needs"), fields.section("attributes")
    parts = NameScope.of_parts(builder.attributes, [need.key for need in stated.named()])
    whole = NameScope.of_parts(
        builder.attributes, parts.needs, [attribute.key for attribute in worth.named()]
    )
    composition = Composition(
        name=entry.key,
        serves=serves.name,
        needs={need.name: need for need in _needs(builder, stated, fields.key_span("needs"))},
        through=_through(builder, fields),
        source=_source(builder, fields, folder),
        where=_conditions(builder, fields, whole),
        distinct=_distinct(builder, fields, [need.key for need in stated.named()]),
        attributes=_whole_attributes(builder, worth, parts),
        loss=fields.number("loss", minimum=0.0, maximum=1.0),
        meaning=fields.text("meaning"),
        span=entry.key_span,
    )
    fields.report_unread()
    return composition


def _needs(builder: RegistryBuilder, section: YamlFields, span: Span) -> list[Need]:
    if not 0 < len(section) <= MAX_NEEDS:
        builder.report(messages.NUMBER_OF_NEEDS, span, most=MAX_NEEDS, count=len(section))
    scope, needs = NameScope.of_offer(builder.attributes), []
    for entry in section.named():
        builder.check_name(entry.key, NAME, "a part", entry.key_span)
        if isinstance(entry.value, YamlScalar) and isinstance(entry.value.value, str):
            # `left: Haul` is short for `left: {capability: Haul}`.
            name, place, when = entry.value.value, entry.value.span, None
        else:
            fields = section.section(entry.key)
            name, place = fields.text("capability", required=True), fields.value_span("capability")
            when = read_expression(builder, fields.node("when"), scope, "boolean")
            fields.report_unread()
        if builder.primitive(name, place) is not None:
            needs.append(Need(entry.key, name, entry.key_span, when))
    return needs


def _distinct(builder: RegistryBuilder, fields: YamlFields, parts: list[str]) -> tuple[str, ...]:
    """The parts that have no agent in common: all of them for `true`."""
    node = fields.node("distinct")
    named = tuple(parts) if isinstance(node, YamlScalar) and node.value is True else fields.texts("distinct")
    if not isinstance(node, YamlList) and not named:
        return ()
    if unknown := [name for name in named if name not in parts]:
        problem = f"there is no part {listed(map(repr, unknown))}"
    elif len(set(named)) < max(2, len(named)):
        problem = "what is distinct is so from another one"
    else:
        return named
    builder.report(messages.NOT_DISTINCT, fields.value_span("distinct"), problem=problem, parts=listed(parts))
    return ()


def _through(builder: RegistryBuilder, fields: YamlFields) -> str:
    """The class in L; its name must be free for it."""
    name, place = fields.text("through", required=True), fields.value_span("through")
    if name:
        builder.check_name(name, TYPE_NAME, "a class", place)
    if name in builder.primitives:
        builder.report(messages.TYPE_IN_USE, place, name=name, what="a class")
    return name


def _source(builder: RegistryBuilder, fields: YamlFields, folder: Path) -> Path:
    """The file with the class in L, relative to the folder of the registry file."""
    text = fields.text("source", required=True)
    path = folder / text
    if text and not os.path.isfile(path):
        builder.report(messages.NO_SOURCE, fields.value_span("source"), path=repr(text))
    return path


def _conditions(builder: RegistryBuilder, fields: YamlFields, scope: NameScope) -> tuple[Expression, ...]:
    read = (read_expression(builder, node, scope, "boolean") for node in fields.items("where"))
    return tuple(expression for expression in read if expression is not None)


def _whole_attributes(
    builder: RegistryBuilder, section: YamlFields, scope: NameScope
) -> dict[str, Expression]:
    """The attributes of the whole: an expression over the parts for each."""
    worth = {}
    for entry in section.named():
        attribute = builder.attribute(entry.key, entry.key_span)
        if attribute is None:
            continue
        expression = read_attribute_expression(builder, entry.value, scope, attribute)
        if expression is not None:
            worth[entry.key] = expression
    return worth


# --- rules that follow from the tree -------------------------------------------------------------------


def subsumptions(primitives: Mapping[str, Primitive]) -> dict[str, Equivalence]:
    """The rules derived from the taxonomy, by name.

    If the term of P is below that of Q, and P has all portals of Q with the same signatures, every offer of P
    is also one of Q without loss: the rule `P-is-Q`.
    """
    by_term: dict[str, list[Primitive]] = {}
    for primitive in primitives.values():
        by_term.setdefault(primitive.id, []).append(primitive)
    rules = {}
    for specific in primitives.values():
        for ancestor in _ancestors(specific.id):
            for general in by_term.get(ancestor, ()):
                if not _lacking(specific, general):
                    rule = _subsumption(specific, general)
                    rules[rule.name] = rule
    return rules


def _lacking(specific: Primitive, general: Primitive) -> tuple[str, ...]:
    """The portals of the general primitive that the specific one lacks, or has with another signature."""
    return tuple(
        name
        for name, portal in general.portals.items()
        if name not in specific.portals or not same_call(portal, specific.portals[name])
    )


def _ancestors(id: str) -> Iterable[str]:
    while "." in id:
        id = id.rpartition(".")[0]
        yield id


def _subsumption(specific: Primitive, general: Primitive) -> Equivalence:
    return Equivalence(
        name=f"{specific.name}-is-{general.name}",
        serves=general.name,
        by=specific.name,
        portals={name: same_name(portal, specific.span) for name, portal in general.portals.items()},
        span=specific.span,
        meaning=f"{general.id} is the more general of the two",
    )

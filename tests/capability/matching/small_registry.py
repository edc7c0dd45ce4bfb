"""Registries and teams in short form, for the tests of matching."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from msgspec.structs import replace

from lfield.capability.condition_compiler import compile_constraint, parse_expression
from lfield.capability.matching.condition_checker import (
    Expectation,
    Expression,
    NameScope,
    check_expression,
)
from lfield.capability.model import (
    Attribute,
    Composition,
    Equivalence,
    Need,
    Primitive,
    Provider,
    Registry,
    ServedPrimitive,
    Value,
    Weights,
)
from lfield.capability.offer import Candidate, Fact, Position
from lfield.text.source_text import Source, Span

NOWHERE = Span(Source("test.yaml", ""), 0, 0)

ATTRIBUTES = {
    attribute.name: attribute
    for attribute in (
        Attribute("payload", "real", NOWHERE, unit="kg", better="more", typical=2.0),
        Attribute("reach", "real", NOWHERE, unit="m", better="more", typical=1.0),
        Attribute("noise", "real", NOWHERE, unit="W", better="less", typical=4.0),
        Attribute("ready", "boolean", NOWHERE),
        Attribute("note", "text", NOWHERE),
        Attribute("power", "text", NOWHERE, values=("battery", "cable")),
        Attribute("environment", "set", NOWHERE, values=("aerial", "aquatic", "terrestrial")),
        Attribute("battery", "real", NOWHERE, better="more", typical=1.0, live=True, max_age=10.0),
        Attribute("north", "real", NOWHERE, unit="m", live=True),
        Attribute("east", "real", NOWHERE, unit="m", live=True),
        Attribute("down", "real", NOWHERE, unit="m", live=True),
    )
}


def constraint_of(text: str) -> Expression:
    """A constraint on an offer."""
    return compile_constraint(text, ATTRIBUTES)


def over_parts(
    text: str, needs: Iterable[str], expected: Expectation = "any", whole: Iterable[str] = ()
) -> Expression:
    """An expression in the rule of a composition."""
    expression, mistakes = parse_expression(text)
    assert expression is not None, mistakes
    assert not (
        found := check_expression(
            expression, NameScope.of_parts(ATTRIBUTES, list(needs), list(whole)), expected
        )
    ), found
    return expression


def provider(
    type: str, serves: Iterable[str] | Mapping[str, str], when: str = "", **attributes: Value
) -> Provider:
    """A resource type that serves primitives."""
    condition = constraint_of(when) if when else None
    served = {name: ServedPrimitive(name, {}, NOWHERE, when=condition) for name in serves}
    return Provider(type, served, NOWHERE, attributes=attributes)


def equivalence(name: str, serves: str, by: str, when: str = "", loss: float = 0.0) -> Equivalence:
    """A one-to-one rule."""
    return Equivalence(name, serves, by, {}, NOWHERE, when=constraint_of(when) if when else None, loss=loss)


def composition(
    name: str,
    serves: str,
    needs: Mapping[str, str | tuple[str, str]],
    where: Sequence[str] = (),
    loss: float = 0.0,
    distinct: tuple[str, ...] = (),
    **attributes: str,
) -> Composition:
    """A one-to-many rule; a need is a primitive, or one with its condition."""
    made = {}
    for need, requirement in needs.items():
        primitive, when = (requirement, "") if isinstance(requirement, str) else requirement
        made[need] = Need(need, primitive, NOWHERE, when=constraint_of(when) if when else None)
    return Composition(
        name,
        serves,
        made,
        "Through",
        Path("through.L"),
        NOWHERE,
        where=tuple(over_parts(text, needs, "boolean", attributes) for text in where),
        distinct=distinct,
        attributes={key: over_parts(text, needs) for key, text in attributes.items()},
        loss=loss,
    )


def registry(
    *entries: Provider | Equivalence | Composition,
    weights: Weights | None = None,
    agents: Mapping[str, Mapping[str, Value]] | None = None,
) -> Registry:
    """Everything together; primitives are those that are named."""
    providers = {e.type: e for e in entries if isinstance(e, Provider)}
    equivalences = {e.name: e for e in entries if isinstance(e, Equivalence)}
    compositions = {e.name: e for e in entries if isinstance(e, Composition)}
    named = {name for p in providers.values() for name in p.serves}
    named |= {name for e in equivalences.values() for name in (e.serves, e.by)}
    for rule in compositions.values():
        named |= {rule.serves, *(need.primitive for need in rule.needs.values())}
    primitives = {name: Primitive(name, f"skill.{name.lower()}", {}, NOWHERE) for name in sorted(named)}
    return Registry(
        terms={},
        attributes=ATTRIBUTES,
        primitives=primitives,
        providers=providers,
        equivalences=equivalences,
        compositions=compositions,
        agents=agents or {},
        weights=weights or Weights(),
    )


def candidate(
    agent: str,
    type: str,
    host: str = "",
    *,
    hops: int = 1,
    refusal: str = "",
    unknown: Mapping[str, str] | None = None,
    **facts: Value | Fact,
) -> Candidate:
    """An agent, on a host of the same name unless another is given."""
    known = {name: value if isinstance(value, Fact) else Fact(value) for name, value in facts.items()}
    return Candidate(agent, type, host or agent, hops, refusal, known, unknown or {})


class Crew:
    """A team of these candidates, which counts the queries for candidates."""

    def __init__(self, *members: Candidate, place: Position | None = None) -> None:
        self.members, self.place = list(members), place
        self.asked = 0

    def candidates(self, resource: str) -> Sequence[Candidate]:
        self.asked += 1
        numbered = enumerate(self.members)
        return [replace(member, number=n) for n, member in numbered if member.type == resource]

    def location(self) -> Position | None:
        return self.place

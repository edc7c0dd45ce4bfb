"""The class of a capability, as text of L: how a portal of the registry becomes a portal of the program.

    class Lift coordinator specific {
        private Offer facts;
        private Crane byCrane;              // one field for every realisation (realisations.py)
        private Climb as_climb_lifts;

        public real lift(real height) {
            if (byCrane != null) return byCrane.lift(height);
            if (as_climb_lifts != null) {
                as_climb_lifts.climb(height);
                return height;
            }
            ...

Of an offer only the fields of its realisation are filled, so a call behaves as one that the program writes
itself: it migrates, throws and returns as the portal of the resource does. The realisations are those that
this program can have: by the resources it names, and by the rules whose needs such resources serve.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

from lfield.capability import realisations
from lfield.capability.model import (
    Argument,
    Composition,
    Equivalence,
    Portal,
    PortalMap,
    Primitive,
    Provider,
    Registry,
)
from lfield.text.source_text import Source

#: The base of every class of a capability: `Offer`, the data of an offer.
PRELUDE = Path(__file__).with_name("offer.L")

#: The methods of every offer, with their parameters.
_FACTS = (
    ("string agent()", "agent()"),
    ("string host()", "host()"),
    ("string way()", "way()"),
    ("real score()", "score()"),
    ("boolean has(string name)", "has(name)"),
    ("real attribute(string name)", "attribute(name)"),
    ("string text(string name)", "text(name)"),
    ("real age(string name)", "age(name)"),
    ("string source(string name)", "source(name)"),
    ("int found()", "found()"),
    ("string note()", "note()"),
)


def prelude() -> Source:
    """The class `Offer`."""
    return Source("Offer.L", PRELUDE.read_text(encoding="utf-8"))


def classes(
    registry: Registry, requested: Iterable[str], resources: Collection[str], reserved: Collection[str] = ()
) -> list[Source]:
    """The classes of some primitives and of all they refer to, for a program with these resources.

    Primitives whose name is `reserved` by another unit of the program do not exist in it.
    """
    served = UsableRealisations(registry, resources, reserved)
    return [Source(f"{name}.L", class_text(served, name)) for name in served.reached(requested)]


class UsableRealisations:
    """The realisations of a registry that a program with certain resources can have."""

    def __init__(
        self, registry: Registry, resources: Collection[str], reserved: Collection[str] = ()
    ) -> None:
        self.primitives = {name: p for name, p in registry.primitives.items() if name not in reserved}
        self._providers: dict[str, list[Provider]] = {}
        for _, provider in sorted(registry.providers.items()):
            for name in provider.serves if provider.type in resources else ():
                self._providers.setdefault(name, []).append(provider)
        self._equivalences = [rule for _, rule in sorted(registry.equivalences.items())]
        self._compositions = [rule for _, rule in sorted(registry.compositions.items())]
        self._usable = self._all_usable()

    def providers(self, primitive: str) -> list[Provider]:
        """The resource types that serve a primitive themselves."""
        return self._providers.get(primitive, [])

    def equivalences(self, primitive: str) -> list[Equivalence]:
        """The one-to-one rules that serve a primitive."""
        return [r for r in self._equivalences if r.serves == primitive and r.by in self._usable]

    def compositions(self, primitive: str) -> list[Composition]:
        """The one-to-many rules that serve a primitive."""
        return [r for r in self._compositions if r.serves == primitive and self._has_all(r)]

    def all_realisations(self) -> dict[str, frozenset[str]]:
        """The realisations of every primitive: the fields that its class has, or would have."""
        return {name: frozenset(self._field_names(name)) for name in self.primitives}

    def _field_names(self, primitive: str) -> Iterator[str]:
        yield from (realisations.direct(provider.type) for provider in self.providers(primitive))
        yield from (realisations.equivalent(rule.name) for rule in self.equivalences(primitive))
        yield from (realisations.composed(rule.name) for rule in self.compositions(primitive))

    def reached(self, requested: Iterable[str]) -> list[str]:
        """The requested primitives and their substitutes, in order of their names."""
        found: set[str] = set()
        waiting = list(requested)
        while waiting:
            name = waiting.pop()
            if name in found or name not in self.primitives:
                continue
            found.add(name)
            waiting += [rule.by for rule in self.equivalences(name)]
            waiting += [need.primitive for rule in self.compositions(name) for need in rule.needs.values()]
        return sorted(found)

    def _all_usable(self) -> set[str]:
        """The primitives that any resource of the program can serve, however indirectly."""
        usable = set(self._providers).intersection(self.primitives)
        before = -1
        while before != len(usable):
            before = len(usable)
            self._usable = usable
            usable |= {r.serves for r in self._equivalences if r.by in usable and r.serves in self.primitives}
            usable |= {
                r.serves for r in self._compositions if self._has_all(r) and r.serves in self.primitives
            }
        return usable

    def _has_all(self, rule: Composition) -> bool:
        return all(need.primitive in self._usable for need in rule.needs.values())


def class_text(served: UsableRealisations, name: str) -> str:
    """The class of one primitive."""
    primitive = served.primitives[name]
    lines = [
        f"// {_comment(f'{name}: {primitive.meaning}' if primitive.meaning else name)}",
        f"// Made from the registry ({primitive.id}).",
        f"class {name} coordinator specific {{",
        "    private Offer facts;",
        *_indented(_fields(served, primitive)),
    ]
    for portal in primitive.portals.values():
        lines += ["", *_indented(_portal(served, primitive, portal))]
    lines.append("")
    lines += _indented(f"public {head} {{ return facts.{call}; }}" for head, call in _FACTS)
    for rule in served.compositions(name):
        lines += ["", *_indented(_maker(rule))]
    return "\n".join([*lines, "}", ""])


def _fields(served: UsableRealisations, primitive: Primitive) -> Iterator[str]:
    for provider in served.providers(primitive.name):
        yield f"private {provider.type} {realisations.direct(provider.type)};"
    for rule in served.equivalences(primitive.name):
        yield f"private {rule.by} {realisations.equivalent(rule.name)};"
    for whole in served.compositions(primitive.name):
        yield f"private {whole.through} {realisations.composed(whole.name)};"
        for need in whole.needs.values():
            yield f"private {need.primitive} {realisations.part(whole.name, need.name)};"


def _portal(served: UsableRealisations, primitive: Primitive, portal: Portal) -> Iterator[str]:
    """The method of a portal: it calls through the one field that is not null."""
    yield f"// {_comment(portal.meaning or portal.name)}" + (f" ({portal.unit})" if portal.unit else "")
    for parameter in portal.parameters:
        unit = f" ({parameter.unit})" if parameter.unit else ""
        yield f"// {parameter.name}{unit}: {_comment(parameter.meaning)}".rstrip(": ")
    parameters = ", ".join(f"{p.type} {p.name}" for p in portal.parameters)
    yield f"public {portal.result} {portal.name}({parameters}) {{"
    for provider in served.providers(primitive.name):
        mapped = provider.serves[primitive.name].portals[portal.name]
        yield from _indented(_branch(realisations.direct(provider.type), portal, mapped))
    for rule in served.equivalences(primitive.name):
        yield from _indented(_branch(realisations.equivalent(rule.name), portal, rule.portals[portal.name]))
    for whole in served.compositions(primitive.name):
        yield from _indented(_composed(whole, portal))
    yield f'    throw new NullException("this {primitive.name} is no offer of the team");'
    yield "}"


def _branch(field: str, portal: Portal, mapped: PortalMap) -> Iterator[str]:
    """The code of one realisation: the mapped call, and the result for the caller."""
    arguments = ", ".join(map(_argument_text, mapped.arguments))
    call = f"{field}.{mapped.target}({arguments})"
    result = mapped.result
    if portal.result == "void":
        steps = [f"{call};", "return;"]
    elif result is None:
        steps = [f"return {call};"]
    elif result.parameter or result.constant is not None:
        steps = [f"{call};", f"return {_argument_text(result)};"]
    else:
        steps = [f"return {_scaled(call, result)};"]
    yield f"if ({field} != null) {{"
    yield from _indented(steps)
    yield "}"


def _composed(rule: Composition, portal: Portal) -> Iterator[str]:
    """The call of a composition, which has the portals of the primitive itself, so no mapping is needed."""
    first = realisations.part(rule.name, next(iter(rule.needs)))
    call = f"{_maker_name(rule)}().{portal.name}({', '.join(p.name for p in portal.parameters)})"
    steps = [f"{call};", "return;"] if portal.result == "void" else [f"return {call};"]
    yield f"if ({first} != null) {{"
    yield from _indented(steps)
    yield "}"


def _maker(rule: Composition) -> Iterator[str]:
    """The method that combines the parts, at the first call."""
    field = realisations.composed(rule.name)
    parts = ", ".join(realisations.part(rule.name, need) for need in rule.needs)
    yield f"private {rule.through} {_maker_name(rule)}() {{"
    yield f"    if ({field} == null) {field} = new {rule.through}({parts});"
    yield f"    return {field};"
    yield "}"


def _maker_name(rule: Composition) -> str:
    return f"whole_{realisations.identifier(rule.name)}"


def _argument_text(argument: Argument) -> str:
    """An argument of a mapped call, in L."""
    if not argument.parameter:
        return _literal(argument.constant)
    return _scaled(argument.parameter, argument)


def _scaled(value: str, by: Argument) -> str:
    """A value in another unit."""
    text = value
    if by.factor != 1:
        text += f" * {_literal(float(by.factor))}"
    if by.offset:
        sign = "+" if by.offset > 0 else "-"
        text += f" {sign} {_literal(abs(float(by.offset)))}"
    return text


def _literal(value: float | int | bool | str | None) -> str:
    """A constant as L writes it."""
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            return '"' + "".join(map(_escaped, value)) + '"'
        case None:
            return "null"
        case _:
            return repr(value)


def _escaped(character: str) -> str:
    if character in '"\\':
        return f"\\{character}"
    return character if character.isprintable() else f"\\u{{{ord(character):x}}}"


def _comment(text: str) -> str:
    """A text of the registry on one line."""
    return " ".join(text.split())


def _indented(lines: Iterable[str]) -> Iterator[str]:
    return (f"    {line}" for line in lines)

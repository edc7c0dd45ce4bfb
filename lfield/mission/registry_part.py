"""The registry as a part of a bundle: the data for decisions of robots, without source positions and
explanations.

An expression is stored as text and syntax tree, so a robot needs no parser. The tree is checked again when it
is read: an evaluator runs only expressions that were checked on the same computer.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from lfield.capability.condition_encoding import decode_tree, encode_tree
from lfield.capability.condition_tree import MAX_LIMIT, Mistake
from lfield.capability.matching.condition_checker import (
    EXPECTATIONS,
    Expectation,
    NameScope,
    check_expression,
)
from lfield.capability.model import (
    Composition,
    Expression,
    Provider,
    Registry,
    Value,
)
from lfield.errors import BundleError
from lfield.mission.bindings import StatedValue

#: Explanations are not needed on a robot.
_EMPTIED = frozenset({"meaning"})
#: Positions in source files.
_LEFT_OUT = frozenset({"span"})


def encode_registry(registry: Registry) -> bytes:
    """The bytes of a registry; deterministic."""
    return msgspec.msgpack.encode(_plain(registry))


def decode_registry(data: bytes | memoryview) -> Registry:
    """The registry in some bytes. Raises BundleError, msgspec.DecodeError and RecursionError."""
    registry = _decoder.decode(data)
    for problem in _problems(registry):
        raise BundleError(f"its registry is invalid: {problem}")
    return registry


def check_stated(stated: Mapping[str, Mapping[str, StatedValue]], registry: Registry) -> None:
    """Check that bindings state only attributes of the registry, each of its type. Raises BundleError."""
    for agent, values in stated.items():
        for name, value in values.items():
            attribute = registry.attributes.get(name)
            stated_value = frozenset(value) if isinstance(value, tuple) else value
            if attribute is None or not attribute.accepts(stated_value):
                raise BundleError(
                    f"its bindings state {name} = {value!r} of {agent}, which is not a valid value"
                )


def _plain(value: Any) -> Any:
    """A value of the model for msgpack. The order of mappings is preserved: that of needs matters."""
    match value:
        case Expression():
            return [value.text, encode_tree(value.tree)]
        case Path():
            return value.name
        case frozenset():
            return sorted(value)
        case Mapping():
            return {key: _plain(item) for key, item in value.items()}
        case tuple():
            return [_plain(item) for item in value]
    if isinstance(value, msgspec.Struct):
        names = (name for name in value.__struct_fields__ if name not in _LEFT_OUT)
        return {name: "" if name in _EMPTIED else _plain(getattr(value, name)) for name in names}
    return value


def _decode_object(kind: type, value: Any) -> Any:
    """Decode types that msgpack lacks: a path from its name, an expression from its text and tree."""
    match value:
        case str() if kind is Path:
            return Path(value)
        case [str(text), tree] if kind is Expression:
            return Expression(text, decode_tree(text, tree))
    raise ValueError(f"malformed {kind.__name__}")


_decoder = msgspec.msgpack.Decoder(Registry, dec_hook=_decode_object)


# --- validation ---------------------------------------------------------------------------------------


def _problems(registry: Registry) -> Iterator[str]:
    """Problems that would fail later: unknown names, values and expressions of a wrong type."""
    yield from _unknown_names("attribute", _named_attributes(registry), registry.attributes)
    yield from _unknown_names("primitive", _named_primitives(registry), registry.primitives)
    # Only after the names are valid: the next checks look them up.
    for name, value in _values(registry):
        if not registry.attributes[name].accepts(value):
            yield f"{value!r} is not a valid value of {name}"
    for query in registry.constraints.values():
        if query.limit is not None and not 1 <= query.limit <= MAX_LIMIT:
            yield f"a query has the limit {query.limit}"
    for expression, scope, expected_type in _expressions(registry):
        yield from map(str, _mistakes(expression, scope, expected_type))


def _unknown_names(kind: str, names: Iterable[str], known: Mapping[str, object]) -> Iterator[str]:
    return (f"there is no {kind} '{name}'" for name in names if name not in known)


def _named_attributes(registry: Registry) -> Iterator[str]:
    yield from (name for name, _ in _values(registry))
    for provider in registry.providers.values():
        yield from provider.live
        yield from (live.attribute for live in provider.live.values())
    for rule in registry.compositions.values():
        yield from rule.attributes


def _named_primitives(registry: Registry) -> Iterator[str]:
    for provider in registry.providers.values():
        yield from provider.serves
        yield from (served.primitive for served in provider.serves.values())
    for rule in registry.equivalences.values():
        yield from (rule.serves, rule.by)
    for composition in registry.compositions.values():
        yield composition.serves
        yield from (need.primitive for need in composition.needs.values())


def _values(registry: Registry) -> Iterator[tuple[str, Value]]:
    for provider in registry.providers.values():
        yield from provider.attributes.items()
        for served in provider.serves.values():
            yield from served.attributes.items()
    for own in registry.agents.values():
        yield from own.items()


def _expressions(registry: Registry) -> Iterator[tuple[Expression | None, NameScope, Expectation]]:
    """Every expression with the scope of its names and its expected type."""
    offer = NameScope.of_offer(registry.attributes)
    for provider in registry.providers.values():
        yield from _of_provider(provider, offer)
    for rule in registry.equivalences.values():
        yield rule.when, offer, "boolean"
    for composition in registry.compositions.values():
        yield from _of_composition(composition, registry, offer)
    for query in registry.constraints.values():
        yield query.condition, offer, "boolean"
        for key in query.order:
            yield key.value, offer, "number"


def _of_provider(
    provider: Provider, offer: NameScope
) -> Iterator[tuple[Expression | None, NameScope, Expectation]]:
    for served in provider.serves.values():
        yield served.when, offer, "boolean"


def _of_composition(
    rule: Composition, registry: Registry, offer: NameScope
) -> Iterator[tuple[Expression | None, NameScope, Expectation]]:
    for need in rule.needs.values():
        yield need.when, offer, "boolean"
    for name, worth in rule.attributes.items():
        expected_type = EXPECTATIONS[registry.attributes[name].type]
        yield worth, NameScope.of_parts(registry.attributes, rule.needs), expected_type
    for condition in rule.where:
        yield condition, NameScope.of_parts(registry.attributes, rule.needs, rule.attributes), "boolean"


def _mistakes(expression: Expression | None, scope: NameScope, expected: Expectation) -> list[Mistake]:
    """The errors of an expression. The check also resolves bare names of members."""
    return [] if expression is None else check_expression(expression, scope, expected)

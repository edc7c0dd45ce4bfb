"""The registry as a part of a bundle: what robots decide by, without places and explanations.

An expression is its text there, and is parsed and checked again when it is read: what an evaluator is given
has always been checked on the same computer.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import msgspec

from lfield.capability.condition import Mistake
from lfield.capability.matching.expression import WANTED, Scope, Wanted, check, parse
from lfield.capability.model import (
    Composition,
    Expression,
    Provider,
    Registry,
    Value,
)
from lfield.errors import BundleError
from lfield.mission.bindings import Stated

#: Explanations are for the desk: nothing that a robot does or says needs them.
_EMPTIED = frozenset({"meaning"})
#: Places in files that are not here.
_LEFT_OUT = frozenset({"span"})


def encode_registry(registry: Registry) -> bytes:
    """The bytes of a registry; the same registry is always the same bytes."""
    return msgspec.msgpack.encode(_plain(registry))


def decode_registry(data: bytes | memoryview) -> Registry:
    """The registry in some bytes. Raises BundleError, msgspec.DecodeError and RecursionError."""
    registry = _decoder.decode(data)
    for problem in _problems(registry):
        raise BundleError(f"its registry makes no sense: {problem}")
    return registry


def check_stated(stated: Mapping[str, Mapping[str, Stated]], registry: Registry) -> None:
    """Bindings state only what the registry knows, each of its kind. Raises BundleError."""
    for agent, values in stated.items():
        for name, value in values.items():
            attribute = registry.attributes.get(name)
            said = frozenset(value) if isinstance(value, tuple) else value
            if attribute is None or not attribute.takes(said):
                raise BundleError(f"its bindings state {value!r} of {agent}, which is no {name}")


def _plain(value: Any) -> Any:
    """A value of the model as msgpack has it. The order of mappings is kept: the order of needs counts."""
    match value:
        case Expression():
            return value.text
        case Path():
            return value.name
        case frozenset():
            return sorted(value)
        case Mapping():
            return {key: _plain(item) for key, item in value.items()}
        case tuple():
            return [_plain(item) for item in value]
    if is_dataclass(value) and not isinstance(value, type):
        names = (field.name for field in fields(value) if field.name not in _LEFT_OUT)
        return {name: "" if name in _EMPTIED else _plain(getattr(value, name)) for name in names}
    return value


def _made(kind: type, value: Any) -> Any:
    """What msgpack does not know: an expression from its text, a path from its name."""
    if not isinstance(value, str):
        raise ValueError(f"a {kind.__name__} is text")
    if kind is Path:
        return Path(value)
    expression, mistakes = parse(value)
    if expression is None:
        raise ValueError("; ".join(map(str, mistakes)))
    return expression


_decoder = msgspec.msgpack.Decoder(Registry, dec_hook=_made)


# --- what must hold -----------------------------------------------------------------------------------


def _problems(registry: Registry) -> Iterator[str]:
    """What would be stumbled over later: names that lead nowhere, values and expressions of a wrong kind."""
    yield from _strangers("attribute", _named_attributes(registry), registry.attributes)
    yield from _strangers("primitive", _named_primitives(registry), registry.primitives)
    # Only now: what is checked next looks these names up.
    for name, value in _values(registry):
        if not registry.attributes[name].takes(value):
            yield f"{value!r} is no value of {name}"
    for expression, scope, wanted in _expressions(registry):
        yield from map(str, _mistakes(expression, scope, wanted))


def _strangers(what: str, names: Iterable[str], known: Mapping[str, object]) -> Iterator[str]:
    return (f"there is no {what} '{name}'" for name in names if name not in known)


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
    for whole in registry.compositions.values():
        yield whole.serves
        yield from (need.primitive for need in whole.needs.values())


def _values(registry: Registry) -> Iterator[tuple[str, Value]]:
    for provider in registry.providers.values():
        yield from provider.attributes.items()
        for served in provider.serves.values():
            yield from served.attributes.items()
    for own in registry.agents.values():
        yield from own.items()


def _expressions(registry: Registry) -> Iterator[tuple[Expression | None, Scope, Wanted]]:
    """Every expression with what its names may mean and what it has to be."""
    offer = Scope.of_offer(registry.attributes)
    for provider in registry.providers.values():
        yield from _of_provider(provider, offer)
    for rule in registry.equivalences.values():
        yield rule.when, offer, "boolean"
    for whole in registry.compositions.values():
        yield from _of_composition(whole, registry, offer)


def _of_provider(provider: Provider, offer: Scope) -> Iterator[tuple[Expression | None, Scope, Wanted]]:
    for served in provider.serves.values():
        yield served.when, offer, "boolean"


def _of_composition(
    rule: Composition, registry: Registry, offer: Scope
) -> Iterator[tuple[Expression | None, Scope, Wanted]]:
    for need in rule.needs.values():
        yield need.when, offer, "boolean"
    for name, worth in rule.attributes.items():
        wanted = WANTED[registry.attributes[name].type]
        yield worth, Scope.of_parts(registry.attributes, rule.needs), wanted
    for condition in rule.where:
        yield condition, Scope.of_parts(registry.attributes, rule.needs, rule.attributes), "boolean"


def _mistakes(expression: Expression | None, scope: Scope, wanted: Wanted) -> list[Mistake]:
    """What is wrong with an expression. Checking also settles what bare names of members mean."""
    return [] if expression is None else check(expression, scope, wanted)

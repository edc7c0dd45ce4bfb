"""Checks of a registry against a program: the resources behind providers, and the classes of rules.

Only resource types of the program are checked; others are unknown. Findings refer to the YAML,
where the promise is made.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path

from msgspec.structs import replace

from lfield.bytecode.program import Program
from lfield.bytecode.side_effects import effectful_methods
from lfield.capability.model import (
    Composition,
    LiveAttribute,
    Portal,
    PortalMap,
    Primitive,
    Provider,
    Registry,
    ServedPrimitive,
)
from lfield.capability.program_types.live_units import COMPATIBLE_TYPES, element
from lfield.capability.registry_reader import messages
from lfield.capability.registry_reader.rule_checks import result_type, wrong_result
from lfield.capability.registry_reader.unit_signatures import (
    Overload,
    Signature,
    argument_type,
    fits,
    fits_all,
    signatures_of,
    written,
)
from lfield.errors import InputFileError
from lfield.lang.parser import parse_file
from lfield.text.input_files import MAX_TEXT, read_bytes
from lfield.text.source_text import Diagnostic, Diagnostics, Source, Span
from lfield.text.suggestions import did_you_mean, listed


def check_against(registry: Registry, signatures: Mapping[str, Signature], found: Diagnostics) -> None:
    """Report portals of providers that a program's resources do not have, or have with other types."""
    for provider, resource in _providers_in_program(registry, signatures):
        for name, served in provider.serves.items():
            _report(_missing_portals(registry.primitives[name], served, resource), found)
        for live in provider.live.values():
            _report(_feed_problems(registry, live, resource), found)


def _report(mistakes: Sequence[Diagnostic], found: Diagnostics) -> None:
    for mistake in mistakes:
        found.add(mistake)


def satisfied(registry: Registry, signatures: Mapping[str, Signature]) -> Registry:
    """The registry without the promises of its providers that the resources of a program cannot keep."""
    fitting = {
        provider.type: replace(
            provider,
            serves={
                name: served
                for name, served in provider.serves.items()
                if not _missing_portals(registry.primitives[name], served, resource)
            },
            live={
                name: live
                for name, live in provider.live.items()
                if not _feed_problems(registry, live, resource)
            },
        )
        for provider, resource in _providers_in_program(registry, signatures)
    }
    return replace(registry, providers={**registry.providers, **fitting})


def _providers_in_program(
    registry: Registry, signatures: Mapping[str, Signature]
) -> Iterator[tuple[Provider, Signature]]:
    """The providers that are resources of a program, with these."""
    for provider in registry.providers.values():
        resource = signatures.get(provider.type)
        if resource is not None and resource.kind == "resource":
            yield provider, resource


def _feed_problems(registry: Registry, live: LiveAttribute, resource: Signature) -> list[Diagnostic]:
    """The problems of a portal that feeds an attribute: it must take no parameters and return a valid
    value.
    """
    if not live.portal:
        return []
    attribute = registry.attributes[live.attribute]
    results = [result for parameters, result in resource.portals.get(live.portal, ()) if not parameters]
    if not results:
        hint = None if live.portal in resource.portals else did_you_mean(live.portal, resource.portals)
        return [messages.LIVE_PORTAL.at(live.span, hint=hint, type=resource.name, portal=live.portal)]
    if element(results[0], live.index) not in COMPATIBLE_TYPES[attribute.type]:
        message = messages.WRONG_QUANTITY.at(
            live.span,
            attribute=attribute.name,
            expected=attribute.type,
            quantity=f"{live.portal}()",
            given=results[0],
        )
        return [message]
    return []


def check_feed_portals(registry: Registry, program: Program, diagnostics: Diagnostics) -> None:
    """Report portals with side effects that are sources of attributes: a host calls them periodically."""
    acting = effectful_methods(program)
    acts = {
        (program.core.classes[record.owner].name, record.name)
        for method, record in enumerate(program.core.methods)
        if record.kind == "portal" and not record.parameters and method in acting
    }
    for provider in registry.providers.values():
        for live in provider.live.values():
            if (provider.type, live.portal) in acts:
                diagnostics.add(messages.LIVE_ACTS.at(live.span, type=provider.type, portal=live.portal))


def check_types(
    registry: Registry,
    mission: Path,
    own: Collection[str],
    find_source: Callable[[str], Path | None],
    diagnostics: Diagnostics,
) -> None:
    """Report providers in the file of a mission that are types neither of its program nor of a library.

    The included file of a provider must always exist.
    `own` are the resource types of the program, `find_source` maps the path of an include to its file.
    """
    extended = [p for p in registry.providers.values() if p.span.source.name == str(mission)]
    others = registry.providers.keys() - {provider.type for provider in extended}
    for provider in extended:
        path = find_source(provider.include) if provider.include else None
        if provider.include and path is None:
            diagnostics.add(messages.NO_LIBRARY.at(provider.span, path=provider.include))
            continue
        if provider.type in own:
            continue
        if path is None:
            hint = did_you_mean(provider.type, sorted({*own, *others}))
            diagnostics.add(messages.NO_TYPE.at(provider.span, hint=hint, type=provider.type))
        elif provider.type not in (units := _units(path) or {}):
            hint = did_you_mean(provider.type, units) or f"it has {listed(units)}"
            message = messages.NOT_IN_LIBRARY.at(
                provider.span, hint=hint, path=provider.include, type=provider.type
            )
            diagnostics.add(message)


def _missing_portals(primitive: Primitive, served: ServedPrimitive, resource: Signature) -> list[Diagnostic]:
    """The portals that a resource lacks for a primitive that its provider serves."""
    found: list[Diagnostic] = []
    missing: dict[Span, list[str]] = {}
    for mapped in served.portals.values():
        if mapped.target in resource.portals:
            found += _signature_problems(primitive, mapped, resource)
        else:
            missing.setdefault(mapped.span, []).append(mapped.target)
    return [*found, *(_missing(span, targets, resource) for span, targets in missing.items())]


def _missing(span: Span, targets: Sequence[str], resource: Signature) -> Diagnostic:
    return messages.NO_TARGET.at(
        span,
        hint=did_you_mean(targets[0], resource.portals) if len(targets) == 1 else None,
        type=resource.name,
        missing=listed(f"'{target}'" for target in targets),
        portals=listed(resource.portals),
    )


def _signature_problems(primitive: Primitive, mapped: PortalMap, resource: Signature) -> list[Diagnostic]:
    """The reasons why an existing portal does not fit its mapping."""
    portal, overloads = primitive.portals[mapped.portal], resource.portals[mapped.target]
    types_given = tuple(argument_type(argument, portal) for argument in mapped.arguments)
    results = [
        result_type(mapped.result, portal, result)
        for types, result in overloads
        if fits_all(types_given, types)
    ]
    if not results:
        message = messages.NO_OVERLOAD.at(
            mapped.span,
            type=resource.name,
            portal=mapped.target,
            given=", ".join(types_given),
            overloads=_format_overloads(mapped.target, overloads),
        )
        return [message]
    if portal.result != "void" and not any(fits(result, portal.result) for result in results):
        return [wrong_result(mapped.span, primitive.name, portal, results[0])]
    return []


def _format_overloads(name: str, overloads: Sequence[Overload]) -> str:
    return listed(written(name, parameters) for parameters, _ in overloads)


# --- classes of compositions --------------------------------------------------------------------------


def check_classes(registry: Registry, diagnostics: Diagnostics) -> None:
    """Report compositions whose class in L is not there, lacks portals, or cannot be made of the parts.

    Reads the sources. Other mistakes in them are reported when a program uses them.
    """
    for rule in registry.compositions.values():
        units = _units(rule.source)
        if units is None:
            continue
        unit = units.get(rule.through)
        if unit is None or unit.kind != "class" or unit.usage != "coordinator":
            diagnostics.add(messages.NO_CLASS.at(rule.span, file=rule.source.name, name=rule.through))
        else:
            _check_class(rule, registry.primitives[rule.serves], unit, diagnostics)


def _units(path: Path) -> dict[str, Signature] | None:
    """The units in a source; None when it cannot be read as L."""
    try:
        text = read_bytes(path, MAX_TEXT).decode("utf-8")
    except (InputFileError, UnicodeDecodeError):
        return None
    file = parse_file(Source(str(path), text), Diagnostics())
    return None if file.broken else signatures_of([file])


def _check_class(rule: Composition, primitive: Primitive, unit: Signature, diagnostics: Diagnostics) -> None:
    lacking = [portal for portal in primitive.portals.values() if not _has_method(unit, portal)]
    if lacking:
        signatures = listed(f"public {_method(portal)}" for portal in lacking)
        message = messages.NO_METHOD.at(
            rule.span, name=unit.name, primitive=primitive.name, signatures=signatures
        )
        diagnostics.add(message)
    parts = tuple(need.primitive for need in rule.needs.values())
    if parts not in unit.constructors:
        signature = f"public {written(unit.name, parts)}"
        diagnostics.add(messages.NO_CONSTRUCTOR.at(rule.span, name=unit.name, signature=signature))


def _has_method(unit: Signature, portal: Portal) -> bool:
    parameter_types = tuple(p.type for p in portal.parameters)
    return any(
        fits_all(parameter_types, types) and fits(result, portal.result)
        for types, result in unit.portals.get(portal.name, ())
    )


def _method(portal: Portal) -> str:
    return written(portal.name, [p.type for p in portal.parameters], portal.result)

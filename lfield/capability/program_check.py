"""Whether a registry fits a program: what providers promise of resources, and rules of their classes.

Only resource types of the program are looked at; of others nothing is known. Findings stand in the YAML,
where the promise is made.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lfield.capability import messages
from lfield.capability.model import Composition, PortalMap, Primitive, Provider, Registry
from lfield.capability.rule_calls import result_type, wrong_result
from lfield.capability.signatures import (
    Overload,
    Signature,
    argument_type,
    fits,
    fits_all,
    signatures_of,
    written,
)
from lfield.errors import InputFileError
from lfield.files import read_bytes
from lfield.lang.parser import parse
from lfield.lang.reading import MAX_BYTES
from lfield.lang.suggest import did_you_mean, listed
from lfield.source import Diagnostics, Source


def check_against(registry: Registry, signatures: Mapping[str, Signature], found: Diagnostics) -> None:
    """Report portals of providers that a program's resources do not have, or have with other types."""
    for provider in registry.providers.values():
        resource = signatures.get(provider.type)
        if resource is not None and resource.kind == "resource":
            _check_provider(registry, provider, resource, found)


def _check_provider(registry: Registry, provider: Provider, resource: Signature, found: Diagnostics) -> None:
    for served in provider.serves.values():
        for mapped in served.portals.values():
            _check_portal(registry.primitives[served.primitive], mapped, resource, found)


def _check_portal(primitive: Primitive, mapped: PortalMap, resource: Signature, found: Diagnostics) -> None:
    portal = primitive.portals[mapped.portal]
    overloads = resource.portals.get(mapped.target, ())
    given = tuple(argument_type(argument, portal) for argument in mapped.arguments)
    taking = [overload for overload in overloads if fits_all(given, overload[0])]
    if not overloads:
        hint = did_you_mean(mapped.target, resource.portals)
        known = listed(resource.portals)
        found.add(
            messages.NO_TARGET.at(
                mapped.span, hint=hint, type=resource.name, portal=mapped.target, portals=known
            )
        )
    elif not taking:
        found.add(
            messages.NO_OVERLOAD.at(
                mapped.span,
                type=resource.name,
                portal=mapped.target,
                given=", ".join(given),
                overloads=_shown(mapped.target, overloads),
            )
        )
    else:
        results = [result_type(mapped.result, portal, result) for _, result in taking]
        if portal.result != "void" and not any(fits(result, portal.result) for result in results):
            found.add(wrong_result(mapped.span, primitive.name, portal, results[0]))


def _shown(name: str, overloads: Sequence[Overload]) -> str:
    return listed(written(name, parameters) for parameters, _ in overloads)


# --- classes of compositions --------------------------------------------------------------------------


def check_classes(registry: Registry, found: Diagnostics) -> None:
    """Report compositions whose class in L is not there, lacks portals, or cannot be made of the parts.

    Reads the sources. What else is wrong in them is said when a program uses them.
    """
    for rule in registry.compositions.values():
        units = _units(rule)
        if units is None:
            continue
        unit = units.get(rule.through)
        if unit is None or unit.kind != "class" or unit.usage != "coordinator":
            found.add(messages.NO_CLASS.at(rule.span, file=rule.source.name, name=rule.through))
        else:
            _check_class(rule, registry.primitives[rule.serves], unit, found)


def _units(rule: Composition) -> dict[str, Signature] | None:
    """The units in the source of a rule; None when it cannot be read as L."""
    try:
        text = read_bytes(rule.source, MAX_BYTES).decode("utf-8")
    except (InputFileError, UnicodeDecodeError):
        return None
    file = parse(Source(str(rule.source), text), Diagnostics())
    return None if file.broken else signatures_of([file])


def _check_class(rule: Composition, primitive: Primitive, unit: Signature, found: Diagnostics) -> None:
    for portal in primitive.portals.values():
        given = tuple(p.type for p in portal.parameters)
        methods = unit.portals.get(portal.name, ())
        if not any(fits_all(given, wanted) and fits(result, portal.result) for wanted, result in methods):
            found.add(
                messages.NO_METHOD.at(
                    rule.span,
                    name=unit.name,
                    primitive=primitive.name,
                    portal=portal.name,
                    signature=f"public {written(portal.name, given, portal.result)}",
                )
            )
    parts = tuple(need.primitive for need in rule.needs.values())
    if parts not in unit.constructors:
        signature = f"public {written(unit.name, parts)}"
        found.add(messages.NO_CONSTRUCTOR.at(rule.span, name=unit.name, signature=signature))

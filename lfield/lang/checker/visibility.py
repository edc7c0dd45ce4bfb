"""The scope rules about naming: which unit may name which (chapters III and IV).

A resource sees no coordinator and no other resource, a coordinator sees all resources and no coordinator,
a class without a usage clause sees neither. What passes through a portal is stricter still.
"""

from __future__ import annotations

from typing import Literal

from lfield.lang import messages, tree
from lfield.lang.checker.symbols import Symbols, describe, innermost
from lfield.lang.syntax import TypeName
from lfield.lang.types import EXCEPTION, UNKNOWN, DeviceType, FutureType, Type
from lfield.text.message_tables import FindingKind
from lfield.text.source_text import Span

#: The place of a type. A device type is valid for a field, and for the constructor of a resource specific
#: class; the rules of a portal are the strictest.
Place = Literal["field", "constructor", "portal", "elsewhere"]


_OF_FUNCTIONS = (
    "a function has numbers, text, arrays, maps, enums and objects: pass what it needs of the other"
)
_OF_FUTURES = "coordinators and coordinator specific classes have futures: pass the result, f.await()"
_COORDINATOR_RULES: dict[tree.Usage, FindingKind] = {
    "resource": messages.RESOURCE_NAMES_COORDINATOR,
    "coordinator": messages.COORDINATOR_NAMES_COORDINATOR,
    "global": messages.GLOBAL_NAMES_COORDINATOR,
}
_RESOURCE_RULES: dict[tree.Usage, FindingKind | None] = {
    "resource": messages.RESOURCE_NAMES_RESOURCE,
    "coordinator": None,
    "global": messages.GLOBAL_NAMES_RESOURCE,
}


def visible_type(symbols: Symbols, viewer: tree.Unit, written: TypeName, place: Place = "elsewhere") -> Type:
    """The type of that name, if `viewer` may name it there; else UNKNOWN, and the rule is reported."""
    kind = symbols.resolve(written)
    element = innermost(kind)
    if isinstance(element, DeviceType):
        return _device_type(symbols, viewer, written, place)
    name = element.name if isinstance(element, FutureType) else written.name
    unit = None if written.name in symbols.library.parameters else symbols.units.get(name)
    if place == "portal":
        if not _may_pass(symbols, viewer, kind, written.span):
            return UNKNOWN
    elif unit is not None and not check_visibility(symbols, viewer, unit, written.span):
        return UNKNOWN
    arguments = (
        [argument for argument in written.arguments if argument.name != "void"] if place != "portal" else []
    )
    parts = [visible_type(symbols, viewer, argument) for argument in arguments]
    return UNKNOWN if UNKNOWN in parts else kind


def check_visibility(symbols: Symbols, viewer: tree.Unit, target: tree.Unit, span: Span) -> bool:
    """Whether `viewer` may name `target`; the broken rule is reported."""
    rule = _rule(viewer, target)
    if rule is not None:
        is_future = target.name.startswith("future<")
        hint = _OF_FUNCTIONS if viewer.function else _OF_FUTURES if is_future else None
        symbols.report(
            rule,
            span,
            hint=hint,
            viewer=describe(viewer),
            unit=viewer.name,
            name=target.name,
            usage=target.usage,
        )
    return rule is None


def _rule(viewer: tree.Unit, target: tree.Unit) -> FindingKind | None:
    """The rule that forbids `viewer` to name `target`, or None."""
    side = viewer.usage
    if target.kind == "coordinator":
        return _COORDINATOR_RULES[side]
    if target.kind == "resource":
        return _RESOURCE_RULES[side]
    if target.usage in ("global", side):
        return None
    if target.capability:
        return messages.CAPABILITY_OUTSIDE
    if side == "global":
        return messages.GLOBAL_NAMES_SPECIFIC
    return messages.RESOURCE_CLASS_OUTSIDE if side == "coordinator" else messages.COORDINATOR_CLASS_OUTSIDE


def _device_type(symbols: Symbols, viewer: tree.Unit, written: TypeName, place: Place) -> Type:
    """A device type is allowed only for a plain field of a resource and in resource specific classes."""
    if viewer.usage == "coordinator":
        symbols.report(
            messages.COORDINATOR_NAMES_DEVICE, written.span, viewer=describe(viewer), name=written.name
        )
        return UNKNOWN
    places = ("field",) if viewer.kind == "resource" else ("field", "constructor")
    if viewer.usage != "resource" or place not in places or written.dimensions:
        symbols.report(messages.DEVICE_PLACE, written.span, name=written.name)
        return UNKNOWN
    return DeviceType(written.name)


def _may_pass(symbols: Symbols, viewer: tree.Unit, kind: Type, span: Span) -> bool:
    """Whether values of the type may pass through a portal, copied with all their parts."""
    element = innermost(kind)
    unit = symbols.unit_of(element)
    if unit is None:
        return True
    if unit.capability:
        return check_visibility(symbols, viewer, unit, span)
    if isinstance(element, FutureType):
        symbols.report(messages.FUTURE_PORTAL, span, type=kind)
        return False
    if unit.kind == "resource" or (unit.kind == "class" and unit.usage == "coordinator"):
        symbols.report(messages.PORTAL_PROXY, span, type=kind)
        return False
    if unit.kind == "class" and unit.usage == "resource":
        symbols.report(messages.PORTAL_RESOURCE_CLASS, span, type=kind)
        return False
    return check_visibility(symbols, viewer, unit, span)


def check_portal_contents(symbols: Symbols, kind: Type, span: Span) -> None:
    """Report a portal type that is or holds an Exception, which may be an object of any class at run time."""
    visited: set[str] = set()
    waiting = [(kind, "")]
    while waiting:
        held, path = waiting.pop()
        element = innermost(held)
        if element == EXCEPTION:
            reason = (
                f"its field {path[1:]} is an Exception"
                if path
                else "an Exception may be an object of any class"
            )
            symbols.report(messages.PORTAL_EXCEPTION, span, type=kind, why=reason)
            return
        unit = symbols.unit_of(element)
        if unit is not None and unit.name not in visited:
            visited.add(unit.name)
            waiting.extend((field.type, f"{path}.{field.name}") for field in unit.fields)

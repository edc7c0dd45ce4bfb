"""Variables and fields: the meaning of a name without parentheses."""

from __future__ import annotations

import re

from lfield.lang import messages, syntax, tree
from lfield.lang.checker.conversions import unknown, with_article
from lfield.lang.checker.library.enum_members import enum_member
from lfield.lang.checker.scope import BodyContext
from lfield.lang.checker.symbols import LIBRARY_NAMES
from lfield.lang.language_library import (
    ENUM_VALUE_METHODS,
    EXCEPTION_METHODS,
    PROXY_METHODS,
    STRING_METHODS,
    array_methods,
    library_of_array,
)
from lfield.lang.parser.foreign.foreign_words import FOREIGN_STATEMENTS, variable_hint
from lfield.lang.types import (
    LIBRARY_CLASSES,
    LOOP,
    STRING,
    UNKNOWN,
    ArrayType,
    ClassType,
    DeviceType,
    EnumType,
    ResourceType,
    Type,
)
from lfield.text.suggestions import choice, did_you_mean

#: A member behind a name, as in `math.sqrt`.
_MEMBER = re.compile(r"\s*\.\s*(\w+)")


def check_variable(body: BodyContext, raw: syntax.Name) -> tree.Expr:
    """A bare name: a local, else a field of the unit itself, else a constant or an enum."""
    local = body.scope.find(raw.name)
    if local is not None:
        return tree.LocalGet(raw.span, local.type, local)
    field = body.field(raw.name)
    if field is not None:
        return tree.FieldGet(raw.span, field.type, body.this(raw.span), field)
    loop = body.unit.loop(raw.name)
    if loop is not None:
        return tree.LoopName(raw.span, LOOP, loop)
    constant = body.symbols.constants.get(raw.name)
    if constant is not None:
        return tree.Literal_(raw.span, constant.type, constant.value)
    enum = body.symbols.enums.get(raw.name)
    if enum is not None:
        return tree.EnumName(raw.span, Type(f"enum {raw.name}"), enum)
    _unknown_variable(body, raw)
    return unknown(raw.span)


def _unknown_variable(body: BodyContext, raw: syntax.Name) -> None:
    name = raw.name
    if body.methods(name) or name in LIBRARY_NAMES or name in body.symbols.functions:
        body.report(messages.CALL_WITHOUT_PARENTHESES, raw.span, name=name, call=f"{name}()")
    elif name in body.symbols.units:
        _type_as_value(body, raw, body.symbols.units[name])
    elif not (body.scope.is_uncertain() or body.is_broken() or body.symbols.missing):
        body.report(messages.UNKNOWN_NAME, raw.span, hint=_variable_hint(body, raw), name=name)


def _type_as_value(body: BodyContext, raw: syntax.Name, unit: tree.Unit) -> None:
    article = f"write {unit.name} x = "
    instead = {
        "class": f"make an object first: {article}new {unit.name}(...);",
        "resource": f'find one first: {article}find{unit.name}("id");',
        "coordinator": "coordinators cannot be reached from anywhere",
    }[unit.kind]
    body.report(messages.TYPE_AS_VALUE, raw.span, name=unit.name, instead=instead)


def _variable_hint(body: BodyContext, raw: syntax.Name) -> str | None:
    name = raw.name
    member = _MEMBER.match(raw.span.source.text, raw.span.end)
    if foreign := variable_hint(name, member[1] if member else "") or FOREIGN_STATEMENTS.get(name):
        return foreign
    top_level = (*body.symbols.constants, *body.symbols.enums)
    fields = () if body.function else (f.name for f in body.unit.named_fields)
    known = [*body.scope.names(), *fields, *top_level, "true", "false", "null"]
    return did_you_mean(name, known) or (_object_hint(body, name, member[1]) if member else None)


def _object_hint(body: BodyContext, name: str, member: str) -> str:
    """The declaration of a variable whose member is used."""
    offering = (unit.name for unit in body.symbols.units.values() if unit.overloads(member, "portal"))
    if body.unit.usage == "coordinator" and (resource := next(offering, None)):
        return f'find a resource first: write {resource} {name} = find{resource}("id");'
    return "declare it first, with a resource, a device type or a class as its type"


def check_member(body: BodyContext, raw: syntax.Member, owner: tree.Expr) -> tree.Expr:
    """`owner.name` without a call: a field of an object."""
    unit = _own_or_named(body, owner)
    if owner.type is UNKNOWN:
        return unknown(raw.span)
    if isinstance(owner, tree.LoopName):
        body.report(messages.LOOP_MEMBER, raw.place, name=raw.name)
        return unknown(raw.span)
    if isinstance(owner, tree.EnumName):
        return enum_member(body, raw, owner.enum)
    if isinstance(owner.type, ResourceType) and raw.name not in method_names(body, owner.type, unit):
        body.report(messages.PROXY_FIELD, raw.place, name=raw.name, resource=owner.type.name)
        return unknown(raw.span)
    has_fields = unit is not None and not isinstance(owner.type, LIBRARY_CLASSES)
    field = unit.field(raw.name) if unit is not None and has_fields else None
    if unit is None or field is None:
        _unknown_field(body, raw, owner.type, unit)
        return unknown(raw.span)
    if not field.public and unit is not body.unit:
        hint = "offers are asked by their methods: who[0].agent()" if unit.capability else None
        body.report(messages.PRIVATE_MEMBER, raw.place, hint=hint, name=raw.name, owner=unit.name)
        return unknown(raw.span)
    return tree.FieldGet(raw.span, field.type, owner, field)


def _own_or_named(body: BodyContext, owner: tree.Expr) -> tree.Unit | None:
    """The unit whose members an expression has; `this` of a resource has those of the resource."""
    return body.unit if isinstance(owner, tree.This) else body.symbols.unit_of(owner.type)


def _unknown_field(body: BodyContext, raw: syntax.Member, kind: Type, unit: tree.Unit | None) -> None:
    methods = method_names(body, kind, unit)
    if raw.name in methods:
        body.report(
            messages.CALL_WITHOUT_PARENTHESES,
            raw.place,
            name=raw.name,
            call=f"{raw.object.span.text}.{raw.name}()",
        )
    elif not methods and unit is None:
        body.report(messages.NO_MEMBERS, raw.place, given=with_article(kind))
    elif unit is None or unit.name not in body.symbols.broken_units:
        fields = (
            [f.name for f in unit.named_fields]
            if unit is not None and not isinstance(kind, LIBRARY_CLASSES)
            else []
        )
        members, names = ("fields", fields) if fields else ("methods", methods)
        known = choice(raw.name, names, f"its {members} are")
        hint = did_you_mean(raw.name, fields) or known
        body.report(messages.UNKNOWN_FIELD, raw.place, hint=hint, type=kind, name=raw.name, known=known)


def method_names(body: BodyContext, kind: Type, unit: tree.Unit | None) -> list[str]:
    """The names that can be called on a value of the type."""
    if unit is not None:
        method_kind = "portal" if isinstance(kind, ResourceType) else "method"
        private = not isinstance(kind, LIBRARY_CLASSES)
        own = dict.fromkeys(m.name for m in unit.methods if m.kind == method_kind and (m.public or private))
        return [*own, *(f.name for f in PROXY_METHODS if method_kind == "portal" and f.name not in own)]
    if isinstance(kind, ArrayType):
        return list(dict.fromkeys(f.name for f in (*array_methods(kind), *library_of_array(kind))))
    if isinstance(kind, DeviceType):
        return [i.name for i in body.symbols.devices[kind.name].instructions]
    if kind == STRING:
        return [f.name for f in STRING_METHODS]
    if isinstance(kind, EnumType):
        return [f.name for f in ENUM_VALUE_METHODS]
    return [f.name for f in EXCEPTION_METHODS] if isinstance(kind, ClassType) else []

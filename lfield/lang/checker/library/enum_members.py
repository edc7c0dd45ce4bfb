"""Members of enums, and the methods of members and enums."""

from __future__ import annotations

from collections.abc import Sequence

from lfield.lang import messages, syntax, tree
from lfield.lang.checker.conversions import OverloadCandidate, choose_overload, unknown
from lfield.lang.checker.library.unit_methods import text_call
from lfield.lang.checker.scope import BodyContext
from lfield.lang.language_library import ENUM_METHODS, ENUM_VALUE_METHODS
from lfield.lang.standard_library.instances import enum_text
from lfield.lang.types import INT, STRING, EnumType, array_of
from lfield.text.suggestions import choice, did_you_mean


def enum_member(body: BodyContext, raw: syntax.Member, enum: tree.Enumeration) -> tree.Expr:
    """`Phase.LIFT`: its number."""
    if raw.name in enum.members:
        return tree.Literal_(raw.span, EnumType(enum.name), enum.members.index(raw.name))
    if any(raw.name == method.name for method in ENUM_METHODS):
        call = f"{enum.name}.{raw.name}()"
        body.report(messages.CALL_WITHOUT_PARENTHESES, raw.place, name=raw.name, call=call)
        return unknown(raw.span)
    known = choice(raw.name, enum.members, "its members are")
    hint = did_you_mean(raw.name, enum.members)
    body.report(messages.UNKNOWN_MEMBER, raw.place, hint=hint, enum=enum.name, name=raw.name, known=known)
    return unknown(raw.span)


def check_enum_call(
    body: BodyContext,
    raw: syntax.Call,
    function: syntax.Member,
    owner: tree.Expr,
    arguments: Sequence[tree.Expr],
) -> tree.Expr:
    """`Phase.values()`, `Phase.of(text)`, `phase.name()` or `phase.ordinal()`."""
    name, place = function.name, function.place
    is_enum = isinstance(owner, tree.EnumName)
    methods = ENUM_METHODS if is_enum else ENUM_VALUE_METHODS
    enum = owner.enum if isinstance(owner, tree.EnumName) else body.symbols.enums[owner.type.name]
    found = next((method for method in methods if method.name == name), None)
    if found is None:
        _unknown_method(body, function, enum, is_enum)
        return unknown(raw.span)
    candidates = [OverloadCandidate(name, found.parameters, found)]
    chosen = choose_overload(body.symbols, place, candidates, arguments)
    if chosen is None:
        return unknown(raw.span)
    kind = EnumType(enum.name)
    match name:
        case "values":
            members = [tree.Literal_(raw.span, kind, number) for number in range(len(enum.members))]
            return tree.Elements(raw.span, array_of(kind), list(members))
        case "of":
            text = enum_text(enum.name, enum.members)
            number = text_call(body, raw, "of", text, {}, chosen[1], INT)
            return tree.Relabel(raw.span, kind, number)
        case "name":
            return member_name(body, raw, owner)
    return tree.Relabel(raw.span, INT, owner)


def member_name(body: BodyContext, raw: syntax.Call, member: tree.Expr) -> tree.Expr:
    """The name of a member of an enum, as a text."""
    enum = body.symbols.enums[member.type.name]
    number = tree.Relabel(member.span, INT, member)
    return text_call(body, raw, "name", enum_text(enum.name, enum.members), {}, [number], STRING)


def _unknown_method(
    body: BodyContext, function: syntax.Member, enum: tree.Enumeration, is_enum: bool
) -> None:
    methods = [method.name for method in (ENUM_METHODS if is_enum else ENUM_VALUE_METHODS)]
    if is_enum and function.name in enum.members:
        body.report(messages.NOT_A_METHOD, function.place, name=function.name)
        return
    known = choice(function.name, methods, "it has")
    kind = f"enum {enum.name}" if is_enum else enum.name
    hint = did_you_mean(function.name, methods) or known
    body.report(
        messages.UNKNOWN_METHOD,
        function.place,
        hint=hint,
        type=kind,
        kind="method",
        name=function.name,
        known=known,
    )

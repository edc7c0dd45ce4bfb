"""The declarations of a program, before any body is checked: units, enums, constants, functions.

All declarations are in one name space. The order of declarations and files does not matter.
"""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import Struct

from lfield.lang import messages, syntax, tree
from lfield.lang.checker.declaration_pass import (
    DeclaredUnit,
    check_callable_name,
    declare_members,
    is_new_name,
    name_units,
)
from lfield.lang.checker.scope import function_unit
from lfield.lang.checker.symbols import LIBRARY_NAMES, Function, Symbols
from lfield.lang.checker.top_level.constant_declarations import declare_constants
from lfield.lang.checker.visibility import visible_type
from lfield.lang.types import UNKNOWN, VOID


class DeclaredProgram(Struct, frozen=True):
    """The input of the second pass: the bodies of units and functions."""

    units: list[DeclaredUnit]
    functions: list[Function]


def declare_program(symbols: Symbols, files: Sequence[syntax.ParsedFile]) -> DeclaredProgram:
    """All declarations of some files; mistakes in names, heads and constants are reported."""
    named = name_units(symbols, [unit for file in files for unit in file.units])
    for enum in (enum for file in files for enum in file.enums):
        _enumeration(symbols, enum)
    constants = [
        constant
        for file in files
        for constant in file.constants
        if is_new_name(symbols, constant.name, constant.span, "constant") and _reserve(symbols, constant)
    ]
    units = declare_members(symbols, named)
    functions = [
        declared
        for file in files
        for function in file.functions
        if (declared := _function(symbols, function)) is not None
    ]
    declare_constants(symbols, constants)
    return DeclaredProgram(units, functions)


def _reserve(symbols: Symbols, constant: syntax.Constant) -> bool:
    """The name of a constant whose value is not computed yet."""
    symbols.constants[constant.name] = tree.Constant(constant.name, UNKNOWN, None, constant.span)
    return True


def _enumeration(symbols: Symbols, raw: syntax.Enumeration) -> None:
    members: dict[str, syntax.EnumMember] = {}
    for member in raw.members:
        earlier = members.setdefault(member.name, member)
        if earlier is not member:
            symbols.report(messages.DUPLICATE_MEMBER, member.span, name=member.name, line=earlier.span.line)
    if members and is_new_name(symbols, raw.name, raw.span, "enum"):
        spans = tuple(member.span for member in members.values())
        symbols.enums[raw.name] = tree.Enumeration(raw.name, tuple(members), raw.span, spans)


def _function(symbols: Symbols, raw: syntax.Method) -> Function | None:
    """The head of a function; None if its name or signature is another one's."""
    others = symbols.functions.get(raw.name, [])
    if not others and not is_new_name(symbols, raw.name, raw.span, "function"):
        return None
    if raw.name not in LIBRARY_NAMES:  # The mistake is already reported.
        check_callable_name(symbols, raw.name, raw.span)
    unit = function_unit(raw.name, raw.span)
    result = VOID if raw.result is None else visible_type(symbols, unit, raw.result)
    head = tree.Method(raw.name, "method", unit, [], result, False, False, raw.span, raw.end)
    for parameter in raw.parameters:
        earlier = next((other for other in head.parameters if other.name == parameter.name), None)
        if earlier is not None:
            line = earlier.span.line
            symbols.report(messages.DUPLICATE_LOCAL, parameter.span, name=parameter.name, line=line)
        kind = visible_type(symbols, unit, parameter.type)
        head.parameters.append(tree.Local(parameter.name, kind, parameter.span))
    signature = head.signature
    for other in others:
        known = all(parameter.type is not UNKNOWN for parameter in head.parameters)
        if known and other.head.signature == signature:
            line = other.head.span.line
            symbols.report(messages.SAME_SIGNATURE, raw.span, signature=signature, line=line)
            return None
    function = Function(head, raw)
    symbols.functions[raw.name] = [*others, function]
    return function

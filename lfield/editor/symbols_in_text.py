"""The meaning of a name in a program: a unit, a member, a variable, an instruction, a library function."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

from msgspec import Struct
from msgspec.structs import replace

from lfield.editor.cursor import Cursor, DeclaredLocal
from lfield.editor.program_model import ProgramModel
from lfield.lang import tree
from lfield.lang.capability_port import parse_query_name
from lfield.lang.checker.expressions import evaluated
from lfield.lang.checker.scope import BodyContext, Scope, function_unit
from lfield.lang.checker.symbols import BUILTIN_TYPES, Symbols
from lfield.lang.language_library import (
    ENUM_METHODS,
    ENUM_VALUE_METHODS,
    EXCEPTION_METHODS,
    FUNCTIONS,
    LIBRARY_OF_FUTURES,
    LIBRARY_OF_MAPS,
    LOOP_METHODS,
    PROXY_METHODS,
    STRING_METHODS,
    LibraryFunction,
    array_methods,
    library_of_array,
)
from lfield.lang.parser.expressions import expression
from lfield.lang.parser.token_stream import ParsingAborted, SyntaxRecovery, TokenStream
from lfield.lang.scanner import TokenKind, scan
from lfield.lang.types import (
    LOOP,
    UNKNOWN,
    ArrayType,
    ClassType,
    DeviceType,
    EnumType,
    FutureType,
    MapType,
    ResourceType,
    Type,
)
from lfield.manifest import DeviceManifest, Instruction
from lfield.text.source_text import Diagnostics, Source, Span

Kind = Literal[
    "unit",
    "method",
    "field",
    "local",
    "library",
    "instruction",
    "device",
    "builtin",
    "file",
    "enum",
    "member",
    "constant",
    "function",
]
Meaning = (
    tree.Unit
    | tree.Method
    | tree.Field
    | tree.Local
    | tree.Constant
    | tree.Enumeration
    | tuple[LibraryFunction, ...]
    | Instruction
    | DeviceManifest
    | Type
)


class TextSymbol(Struct, frozen=True):
    """A symbol; `span` is the name in its declaration, None if no program declares it.

    `key` is equal for all names that a renaming changes together. `prefix` is the text before the name of a
    resource or capability in `findArm`.
    """

    kind: Kind
    name: str
    key: tuple[object, ...]
    span: Span | None
    meaning: Meaning
    prefix: str = ""
    owner: str = ""


class TopLevelSymbols:
    """Constants, enums with their members, and functions."""

    def __init__(self, symbols: Symbols) -> None:
        self._symbols = symbols

    def named(self, name: str) -> TextSymbol | None:
        """The constant, enum or function of a name."""
        if (constant := self._symbols.constants.get(name)) is not None:
            return TextSymbol("constant", name, ("top", name), constant.span, constant)
        if (enum := self._symbols.enums.get(name)) is not None:
            return TextSymbol("enum", name, ("top", name), enum.span, enum)
        return self.function(name)

    def function(self, name: str) -> TextSymbol | None:
        """The first function of a name; overloads are renamed together."""
        found = self._symbols.functions.get(name)
        return None if found is None else self._of_function(found[0].head)

    def all(self) -> Iterator[TextSymbol]:
        """All symbols, without the members of enums."""
        for name in (*self._symbols.constants, *self._symbols.enums, *self._symbols.functions):
            if (found := self.named(name)) is not None:
                yield found

    def members(self, enum: tree.Enumeration) -> list[TextSymbol]:
        """The members of an enum, and its methods."""
        found = [self._member(enum, number) for number in range(len(enum.members))]
        return [*found, *(_of_library(method.name, [method]) for method in ENUM_METHODS)]

    def declared_at(self, span: Span) -> TextSymbol | None:
        """The symbol whose declaration has its name at a place."""
        for constant in self._symbols.constants.values():
            if constant.span == span:
                return self.named(constant.name)
        for enum in self._symbols.enums.values():
            if enum.span == span:
                return self.named(enum.name)
            if span in enum.spans:
                return self._member(enum, enum.spans.index(span))
        heads = (function.head for functions in self._symbols.functions.values() for function in functions)
        found = next((head for head in heads if head.span == span), None)
        return None if found is None else self._of_function(found)

    def _of_function(self, head: tree.Method) -> TextSymbol:
        return TextSymbol("function", head.name, ("top", head.name), head.span, head)

    def _member(self, enum: tree.Enumeration, number: int) -> TextSymbol:
        name = enum.members[number]
        key = ("member", enum.name, name)
        return TextSymbol("member", name, key, enum.spans[number], enum, owner=enum.name)


class TextSymbols:
    """The symbols of the present program."""

    def __init__(self, model: ProgramModel) -> None:
        self._model = model
        self._symbols = replace(model.symbols, found=Diagnostics(), _reported=set())
        self.top_level = TopLevelSymbols(self._symbols)

    @property
    def program(self) -> Symbols:
        """The declarations of the program."""
        return self._symbols

    # --- names ------------------------------------------------------------------------------------------

    def at(self, cursor: Cursor) -> TextSymbol | None:
        """The meaning of the name at a cursor."""
        token = cursor.token
        if token.kind is not TokenKind.NAME and token.text not in BUILTIN_TYPES:
            return None
        if cursor.text(-1) == ".":
            return self._member(cursor)
        return self._declared_here(cursor) or self._unqualified(cursor)

    def _declared_here(self, cursor: Cursor) -> TextSymbol | None:
        """The symbol whose declaration has the name at the cursor."""
        unit, token = cursor.unit, cursor.token
        if (declared := self.top_level.declared_at(token.span)) is not None:
            return declared
        if unit is None or cursor.method in cursor.part.file.functions:
            local = cursor.local_here()
            return None if local is None else self._of_local(local)
        unit_symbol = self._symbols.units.get(unit.name)
        if token.span == unit.span or unit_symbol is None:
            return None if unit_symbol is None else self.of_unit(unit_symbol)
        for method in unit_symbol.methods:
            if method.span == token.span:
                return self.of_unit(unit_symbol) if method.kind == "constructor" else self.of_method(method)
        for field in unit_symbol.fields:
            if field.span == token.span:
                return self.of_field(unit_symbol, field)
        local = cursor.local_here()
        return None if local is None else self._of_local(local)

    def _unqualified(self, cursor: Cursor) -> TextSymbol | None:
        """The symbol of a name without an owner."""
        name = cursor.token.text
        unit = self.unit(cursor)
        if cursor.text(1) == "(" and cursor.text(-1) != "new":
            return self._called(cursor, unit)
        if cursor.text(-1) != "new":
            variable = self.variable(cursor, name)
            if variable is not None:
                return variable
            loop = unit.loop(name) if unit is not None else None
            if loop is not None:
                return self.of_method(loop.body)
        return self.top_level.named(name) or self.type_named(name)

    def variable(self, cursor: Cursor, name: str) -> TextSymbol | None:
        """The local, field or constant of a name at a cursor."""
        local = cursor.locals().get(name)
        if local is not None:
            return self._of_local(local)
        unit = self.unit(cursor)
        field = unit.field(name) if unit is not None else None
        if unit is not None and field is not None:
            return self.of_field(unit, field)
        loop = unit.loop(name) if unit is not None else None
        if loop is not None:
            return self.of_method(loop.body)
        return self.top_level.named(name) if name in self._symbols.constants else None

    def _called(self, cursor: Cursor, unit: tree.Unit | None) -> TextSymbol | None:
        """The symbol of a name before arguments."""
        name = cursor.token.text
        methods = unit.overloads(name, "method") if unit is not None else ()
        if methods:
            return self.of_method(self._chosen(cursor, methods))
        if (function := self.top_level.function(name)) is not None:
            return function
        if name.startswith("find") and (found := self._symbols.resource(name[4:])) is not None:
            return self.of_unit(found, "find")
        query = parse_query_name(name)
        if query is not None and (offered := self._symbols.capability(query[1])) is not None:
            return self.of_unit(offered, query[0])
        functions = [function for function in FUNCTIONS if function.name == name]
        return _of_library(name, functions) if functions else None

    def type_named(self, name: str) -> TextSymbol | None:
        """The unit, enum, device type or built-in type of a name."""
        if name in self._symbols.enums:
            return self.top_level.named(name)
        if (unit := self._symbols.units.get(name)) is not None:
            return self.of_unit(unit)
        if (device := self._symbols.devices.get(name)) is not None:
            return TextSymbol("device", name, ("device", name), None, device)
        if (builtin := BUILTIN_TYPES.get(name)) is not None:
            return TextSymbol("builtin", name, ("builtin", name), None, builtin)
        return None

    # --- members ----------------------------------------------------------------------------------------

    def _member(self, cursor: Cursor) -> TextSymbol | None:
        """The symbol of a name after a dot."""
        name = cursor.token.text
        candidates = [candidate for candidate in self.members(cursor) if candidate.name == name]
        methods = [
            candidate.meaning for candidate in candidates if isinstance(candidate.meaning, tree.Method)
        ]
        if methods and cursor.text(1) == "(":
            return self.of_method(self._chosen(cursor, methods))
        return candidates[0] if candidates else None

    def members(self, cursor: Cursor) -> list[TextSymbol]:
        """The symbols that can follow the dot before a cursor."""
        owner = cursor.owner()
        if owner in self._symbols.enums and owner not in cursor.locals():
            return self.top_level.members(self._symbols.enums[owner])
        kind = self.type_of(cursor, owner)
        unit = self.unit(cursor) if owner == "this" else self._symbols.unit_of(kind)
        if isinstance(kind, MapType):
            return [_of_library(function.name, [function]) for function in LIBRARY_OF_MAPS]
        if isinstance(kind, FutureType):
            names = dict.fromkeys(function.name for function in LIBRARY_OF_FUTURES)
            return [
                _of_library(n, [function for function in LIBRARY_OF_FUTURES if function.name == n])
                for n in names
            ]
        if unit is not None:
            return list(self._unit_members(unit, kind, is_own=unit is self.unit(cursor)))
        match kind:
            case DeviceType():
                device = self._symbols.devices[kind.name]
                return [
                    TextSymbol(
                        "instruction",
                        function.name,
                        ("instruction", kind.name, function.name),
                        None,
                        function,
                        owner=kind.name,
                    )
                    for function in device.instructions
                ]
            case ArrayType():
                return [_of_library(name, _array_functions(kind, name)) for name in _array_names(kind)]
            case ClassType():
                return [_of_library(method.name, [method]) for method in EXCEPTION_METHODS]
            case EnumType():
                return [_of_library(method.name, [method]) for method in ENUM_VALUE_METHODS]
        functions = {"string": STRING_METHODS, LOOP.name: LOOP_METHODS}.get(kind.name, ())
        return [_of_library(method.name, [method]) for method in functions]

    def _unit_members(self, unit: tree.Unit, kind: Type, *, is_own: bool) -> Iterator[TextSymbol]:
        is_proxy = isinstance(kind, ResourceType)
        for method in unit.methods:
            if method.kind == ("portal" if is_proxy else "method") and (method.public or is_own):
                yield self.of_method(method)
        if is_proxy:
            yield from (_of_library(method.name, [method]) for method in PROXY_METHODS)
        else:
            yield from (self.of_field(unit, field) for field in unit.named_fields if field.public or is_own)

    def _chosen(self, cursor: Cursor, methods: Sequence[tree.Method]) -> tree.Method:
        """The overload that a call selects; the first one if that is not known."""
        found = self._evaluated(cursor, cursor.call()) if len(methods) > 1 else None
        match found:
            case tree.Call():
                return found.method
            case tree.PortalCall():
                return found.portal
        return methods[0]

    # --- expressions ------------------------------------------------------------------------------------

    def unit(self, cursor: Cursor) -> tree.Unit | None:
        """The unit around a cursor."""
        return None if cursor.unit is None else self._symbols.units.get(cursor.unit.name)

    def type_of(self, cursor: Cursor, text: str) -> Type:
        """The type of an expression at a cursor; UNKNOWN if it has mistakes."""
        found = self._evaluated(cursor, text)
        return UNKNOWN if found is None else found.type

    def _evaluated(self, cursor: Cursor, text: str) -> tree.Expr | None:
        unit = self.unit(cursor)
        if unit is None and cursor.method is not None:
            unit = function_unit(cursor.method.name, cursor.method.span)
        if unit is None or not text:
            return None
        discarded = Diagnostics()
        try:
            raw = expression(TokenStream(scan(Source("", text), discarded), discarded))
        except (SyntaxRecovery, ParsingAborted):
            return None
        symbols = replace(self._symbols, found=discarded, _reported=set())
        known = {name: self.local(local) for name, local in cursor.locals().items()}
        span = unit.span
        method = tree.Method("", "method", unit, [], UNKNOWN, False, False, span, span)
        context = BodyContext(symbols, unit, method, Scope(None, known), function=unit.function)
        return evaluated(context, raw)

    def local(self, written: DeclaredLocal) -> tree.Local:
        """A variable with its type."""
        symbols = replace(self._symbols, found=Diagnostics(), _reported=set())
        return tree.Local(written.token.text, symbols.resolve(written.type), written.token.span)

    # --- symbols ----------------------------------------------------------------------------------------

    def of_unit(self, unit: tree.Unit, prefix: str = "") -> TextSymbol:
        """A unit; `prefix` is `find` in `findArm`."""
        return TextSymbol("unit", unit.name, ("unit", unit.name), unit.span, unit, prefix)

    def of_method(self, method: tree.Method) -> TextSymbol:
        """A method or portal; overloads are renamed together."""
        unit = method.unit.name
        return TextSymbol(
            "method", method.name, ("member", unit, method.name), method.span, method, owner=unit
        )

    def of_field(self, unit: tree.Unit, field: tree.Field) -> TextSymbol:
        """A field of a unit."""
        return TextSymbol(
            "field", field.name, ("member", unit.name, field.name), field.span, field, owner=unit.name
        )

    def _of_local(self, local: DeclaredLocal) -> TextSymbol:
        span = local.token.span
        return TextSymbol(
            "local", local.token.text, ("local", span.source, span.start), span, self.local(local)
        )


def _of_library(name: str, functions: Sequence[LibraryFunction]) -> TextSymbol:
    return TextSymbol("library", name, ("library", name), None, tuple(functions))


def _array_functions(kind: ArrayType, name: str) -> list[LibraryFunction]:
    """The methods of arrays of that name."""
    return [function for function in (*array_methods(kind), *library_of_array(kind)) if function.name == name]


def _array_names(kind: ArrayType) -> list[str]:
    return list(dict.fromkeys(function.name for function in (*array_methods(kind), *library_of_array(kind))))

"""The declarations of a program, and the report of mistakes: shared by all modules of the checker."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from msgspec import Struct, field

from lfield.lang import messages, syntax, tree
from lfield.lang.capability_port import CapabilityTypes
from lfield.lang.language_library import FUNCTIONS
from lfield.lang.parser.foreign.foreign_words import type_hint
from lfield.lang.standard_library.instances import LibraryUses
from lfield.lang.syntax import BAD_TYPE, TypeName
from lfield.lang.types import (
    BOOLEAN,
    BUILTIN_EXCEPTIONS,
    EXCEPTION,
    INT,
    REAL,
    STRING,
    TICKET,
    UNKNOWN,
    VOID,
    ArrayType,
    ClassType,
    DeviceType,
    EnumType,
    FutureType,
    MapType,
    ResourceType,
    Type,
    array_of,
    future_of,
    map_of,
)
from lfield.manifest import DeviceManifest
from lfield.text.message_tables import FindingKind
from lfield.text.source_text import Diagnostics, Span
from lfield.text.suggestions import closest

#: Names of types that every program has.
BUILTIN_TYPES: dict[str, Type] = {
    **{t.name: t for t in (BOOLEAN, INT, REAL, STRING, VOID, EXCEPTION)},
    **{name: ClassType(name) for name in BUILTIN_EXCEPTIONS},
}
EXCEPTION_NAMES = (EXCEPTION.name, *BUILTIN_EXCEPTIONS)
LIBRARY_NAMES = frozenset(f.name for f in FUNCTIONS)

_RETURN_LIKE = ("return", "throw", "else")


class Function(Struct, frozen=True):
    """A function of the top level: its head in a unit of its own, and its written body."""

    head: tree.Method
    written: syntax.Method


class Symbols(Struct):
    """The declarations of a program at its top level, and the device types that it may use.

    `capabilities` is the registry, when there is one; `generated` are the names of the classes made from it.
    `incomplete`: declarations may be missing (a syntax error, a missing include), so unknown types are not
    reported; `missing`: a file is, so unknown names are not reported either. `broken_units` may lack members
    for the same reason.
    """

    devices: Mapping[str, DeviceManifest]
    found: Diagnostics
    units: dict[str, tree.Unit] = field(default_factory=dict)
    enums: dict[str, tree.Enumeration] = field(default_factory=dict)
    constants: dict[str, tree.Constant] = field(default_factory=dict)
    functions: dict[str, list[Function]] = field(default_factory=dict)
    broken_units: set[str] = field(default_factory=set)
    incomplete: bool = False
    missing: bool = False
    capabilities: CapabilityTypes | None = None
    generated: frozenset[str] = frozenset()
    #: The types of arrays that the program makes longer or shorter, and its uses of the library in L.
    growing: set[Type] = field(default_factory=set)
    library: LibraryUses = field(default_factory=LibraryUses)
    has_futures: bool = False
    _reported: set[tuple[str, str, int, str]] = field(default_factory=set)

    def report(self, message: FindingKind, span: Span, *, hint: str | None = None, **values: object) -> None:
        """Add a finding, once per line for the same text."""
        key = (message.code, span.source.name, span.line, span.text)
        if key not in self._reported:
            self._reported.add(key)
            self.found.add(message.at(span, hint=hint, **values))

    def declaration(self, name: str) -> Span | None:
        """The place of the name that is declared at the top level."""
        if name in self.functions:
            return self.functions[name][0].head.span
        declared = self.units.get(name) or self.enums.get(name) or self.constants.get(name)
        return None if declared is None else declared.span

    def unit_of(self, kind: Type) -> tree.Unit | None:
        """The class or resource of a type; None for any other type."""
        return self.units.get(kind.name) if isinstance(kind, ClassType | ResourceType) else None

    def resource(self, name: str) -> tree.Unit | None:
        unit = self.units.get(name)
        return unit if unit is not None and unit.kind == "resource" else None

    def capability(self, name: str) -> tree.Unit | None:
        """The class of the capability of that name, if the program uses it."""
        unit = self.units.get(name)
        return unit if unit is not None and unit.capability else None

    def resource_names(self) -> list[str]:
        return [name for name, unit in self.units.items() if unit.kind == "resource"]

    def capability_names(self) -> Collection[str]:
        """The names of all capabilities, used or not: for hints."""
        return self.capabilities.names() if self.capabilities is not None else ()

    def resolve(self, written: TypeName) -> Type:
        """The type of that name, or UNKNOWN (reported) if there is none. Access is not checked."""
        element = self._element(written)
        for _ in range(written.dimensions if element is not UNKNOWN else 0):
            element = array_of(element)
        return element

    def _element(self, written: TypeName) -> Type:
        name = written.name
        if name in self.library.parameters:
            return self.library.parameters[name]
        if written.arguments:
            return self._future(written) if written.name == "future" else self._map(written)
        if name in BUILTIN_TYPES:
            return BUILTIN_TYPES[name]
        unit = self.units.get(name)
        if unit is not None:
            return ResourceType(name) if unit.kind == "resource" else ClassType(name)
        if name in self.enums:
            return EnumType(name)
        if name in self.devices:
            return DeviceType(name)
        if type_hint(name) or (name != BAD_TYPE and not self.incomplete):
            self.report(messages.UNKNOWN_TYPE, written.span, hint=self._type_hint(name), name=name)
        return UNKNOWN

    def _map(self, written: TypeName) -> Type:
        """The type of a map; its class is made at the first use."""
        if len(written.arguments) != 2:
            self.report(messages.MAP_TYPES, written.span)
            return UNKNOWN
        key, value = map(self.resolve, written.arguments)
        if key not in (STRING, INT, UNKNOWN) and not isinstance(key, EnumType):
            self.report(messages.MAP_KEY, written.arguments[0].span, given=key)
            return UNKNOWN
        if isinstance(value, DeviceType):
            self.report(messages.DEVICE_PLACE, written.arguments[1].span, name=value.name)
            return UNKNOWN
        if UNKNOWN in (key, innermost(value)):
            return UNKNOWN
        kind = map_of(key, value)
        self.library_class(kind)
        return kind

    def _future(self, written: TypeName) -> Type:
        """The type of a future; its class is made at the first use."""
        if len(written.arguments) != 1:
            self.report(messages.FUTURE_TYPE, written.span)
            return UNKNOWN
        value = self.resolve(written.arguments[0])
        if isinstance(value, DeviceType):
            self.report(messages.DEVICE_PLACE, written.arguments[0].span, name=value.name)
            return UNKNOWN
        if innermost(value) is UNKNOWN:
            return UNKNOWN
        kind = future_of(value)
        self.library_class(kind)
        return kind

    def library_class(self, kind: MapType | FutureType) -> tree.Unit:
        """The class of a type of maps or futures: from the text of the library, with types for its names."""
        if kind.name not in self.units:
            parameters: dict[str, Type] = {"T": kind.value, "ticket": TICKET}
            usage: tree.Usage = "coordinator"
            self.has_futures |= isinstance(kind, FutureType)
            if isinstance(kind, MapType):
                parameters = {"K": kind.key, "V": kind.value}
                held = self.unit_of(innermost(kind.value))
                usage = "global" if held is None else held.usage
                if held is not None and held.kind == "resource":
                    usage = "coordinator"
            with self.library.bound(parameters):
                self.units[kind.name] = self.library.class_of(kind, usage, self.resolve)
        return self.units[kind.name]

    def _type_hint(self, name: str) -> str | None:
        if foreign := type_hint(name):
            return foreign
        known = [
            *BUILTIN_TYPES,
            *self.units,
            *self.enums,
            *self.devices,
            *self.capability_names(),
            *_RETURN_LIKE,
        ]
        close = closest(name, known)
        return f"did you mean '{close}'?" if close else None


def device_in(symbols: Symbols, kind: Type) -> str:
    """A device of objects of the type, in a field or in an object that a field refers to; '' without one."""
    visited: set[str] = set()
    waiting = [(innermost(kind), "")]
    while waiting:
        held, path = waiting.pop()
        if isinstance(held, DeviceType):
            return path[1:]
        unit = symbols.unit_of(held)
        if unit is not None and unit.kind == "class" and unit.name not in visited:
            visited.add(unit.name)
            waiting.extend((innermost(field.type), f"{path}.{field.name}") for field in unit.fields)
    return ""


def describe(unit: tree.Unit) -> str:
    """A unit in messages about scope rules: `the resource specific class 'CacheTree'`."""
    if unit.function:
        return f"the function '{unit.name}'"
    if unit.kind != "class":
        return f"the {unit.kind} '{unit.name}'"
    clause = "" if unit.usage == "global" else f"{unit.usage} specific "
    return f"the {clause}class '{unit.name}'"


def innermost(kind: Type) -> Type:
    """The type of the innermost elements of an array type; any other type unchanged."""
    while isinstance(kind, ArrayType):
        kind = kind.element
    return kind

"""First pass: every unit with its fields and the heads of its methods, before any body is read."""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import Struct, field

from lfield.lang import messages, syntax
from lfield.lang.capability_port import parse_query_name
from lfield.lang.checker.library.loop_members import add_loop, declare_loops
from lfield.lang.checker.symbols import BUILTIN_TYPES, LIBRARY_NAMES, Symbols, describe
from lfield.lang.checker.visibility import Place, check_portal_contents, visible_type
from lfield.lang.language_library import YIELDING
from lfield.lang.tree import Field, Local, Method, Unit
from lfield.lang.types import STRING, UNKNOWN, VOID, DeviceType, Type, array_of
from lfield.text.source_text import Span


class DeclaredUnit(Struct):
    """A unit with the input of the second pass: bodies (None: not written) and initialisers."""

    unit: Unit
    bodies: list[tuple[Method, syntax.Method | None]] = field(default_factory=list)
    initialisers: list[tuple[Field, syntax.Expr]] = field(default_factory=list)


NamedUnits = Sequence[tuple[syntax.Unit, DeclaredUnit]]


def name_units(symbols: Symbols, units: Sequence[syntax.Unit]) -> NamedUnits:
    """All units of a program without their members, in source order; mistakes in names are reported."""
    return [(raw, DeclaredUnit(unit)) for raw in units if (unit := _unit(symbols, raw)) is not None]


def declare_members(symbols: Symbols, pairs: NamedUnits) -> list[DeclaredUnit]:
    """The fields and the heads of the methods of the units; mistakes in them are reported."""
    for raw, declared in pairs:
        _fields(symbols, raw, declared)
    for raw, declared in pairs:
        _Methods(symbols, raw, declared).declare()
    return [declared for _, declared in pairs]


def _unit(symbols: Symbols, raw: syntax.Unit) -> Unit | None:
    """A unit under its name, or None when the name is another unit's."""
    if not is_new_name(symbols, raw.name, raw.span, raw.kind):
        return None
    if raw.broken:
        symbols.broken_units.add(raw.name)
    unit = Unit(raw.name, raw.kind, raw.usage, raw.span, capability=raw.name in symbols.generated)
    symbols.units[raw.name] = unit
    return unit


def is_new_name(symbols: Symbols, name: str, span: Span, kind: str) -> bool:
    """Whether no other declaration of the top level has the name; one that has it is reported."""
    existing = _existing_meaning(symbols, name)
    if existing is not None:
        symbols.report(messages.NAME_IN_USE, span, name=name, what=existing, kind=kind)
    earlier = symbols.declaration(name)
    if earlier is not None:
        where = f"{earlier.source.name}, line {earlier.line}"
        symbols.report(messages.DUPLICATE_UNIT, span, name=name, place=where)
    return earlier is None


def _existing_meaning(symbols: Symbols, name: str) -> str | None:
    """The meaning of a name before the program begins, or None."""
    if name in BUILTIN_TYPES:
        return "a built-in class"
    if name in LIBRARY_NAMES - YIELDING:
        return "a library function"
    if name in symbols.devices:
        return f"a device type of the driver {symbols.devices[name].driver}"
    return None


def _fields(symbols: Symbols, raw: syntax.Unit, declared: DeclaredUnit) -> None:
    unit = declared.unit
    for written in raw.fields:
        kind = visible_type(symbols, unit, written.type, "field")
        earlier = unit.field(written.name)
        if earlier is not None:
            line = earlier.span.line
            symbols.report(messages.DUPLICATE_FIELD, written.span, name=written.name, line=line)
            continue
        field = Field(written.name, kind, len(unit.fields), written.public, written.span)
        unit.add_field(field)
        if written.value is None:
            continue
        if isinstance(kind, DeviceType):
            example = first_instruction(symbols, kind)
            symbols.report(messages.DEVICE_USE, written.value.span, name=field.name, instruction=example)
        else:
            declared.initialisers.append((field, written.value))


def first_instruction(symbols: Symbols, kind: DeviceType) -> str:
    """The name of an instruction of a device type, for a hint."""
    instructions = symbols.devices[kind.name].instructions
    return instructions[0].name if instructions else "instruction"


class _Methods:
    """The methods of one unit."""

    def __init__(self, symbols: Symbols, raw: syntax.Unit, declared: DeclaredUnit) -> None:
        self.symbols, self.raw, self.declared, self.unit = symbols, raw, declared, declared.unit
        self.signatures: dict[str, Method] = {}

    def declare(self) -> None:
        """Every method that is allowed here, and a constructor for a class without one."""
        for written in self.raw.methods:
            if self.has_place(written):
                self.add(self.head(written), written)
        declare_loops(self.symbols, self.unit)
        kinds = [m.kind for m in self.raw.methods]
        whole = self.unit.name not in self.symbols.broken_units
        if self.unit.kind == "class" and "constructor" not in kinds:
            where = self.unit.span
            constructor = Method(
                self.unit.name, "constructor", self.unit, [], VOID, True, False, where, where
            )
            self.add(constructor, None)
        elif self.unit.kind != "class" and "init" not in kinds and whole:
            self.symbols.report(messages.NO_INIT, self.unit.span, unit=describe(self.unit))

    def has_place(self, written: syntax.Method) -> bool:
        """Whether this unit may have such a method; if not, calls of it are not reported any more."""
        if written.kind == "init" and self.unit.kind == "class":
            self.symbols.report(messages.INIT_IN_CLASS, written.span, name=self.unit.name)
            return False
        if written.kind == "loop" and self.unit.kind != "resource":
            self.symbols.report(messages.LOOP_PLACE, written.span, unit=describe(self.unit))
            return False
        if written.kind == "portal" and self.unit.kind != "resource":
            self.symbols.report(messages.PORTAL_PLACE, written.span, unit=describe(self.unit))
            self.symbols.broken_units.add(self.unit.name)
            return False
        return True

    def head(self, written: syntax.Method) -> Method:
        """The method with its parameters and result, without its body."""
        result = VOID if written.result is None else self.type(written, written.result)
        method = Method(
            written.name,
            written.kind,
            self.unit,
            [],
            result,
            written.public,
            written.synchronized,
            written.span,
            written.end,
        )
        for parameter in written.parameters:
            kind = self.type(written, parameter.type)
            self.parameter(method, Local(parameter.name, kind, parameter.span))
        return method

    def type(self, written: syntax.Method, name: syntax.TypeName) -> Type:
        """The type of a parameter or result; types that pass through a portal have rules of their own."""
        if written.kind != "portal":
            place: Place = "constructor" if written.kind == "constructor" else "elsewhere"
            return visible_type(self.symbols, self.unit, name, place)
        kind = visible_type(self.symbols, self.unit, name, "portal")
        check_portal_contents(self.symbols, kind, name.span)
        return kind

    def parameter(self, method: Method, local: Local) -> None:
        """Add a parameter; two of one name are reported."""
        earlier = next((p for p in method.parameters if p.name == local.name), None)
        if earlier is not None:
            line = earlier.span.line
            self.symbols.report(messages.DUPLICATE_LOCAL, local.span, name=local.name, line=line)
        method.parameters.append(local)

    def add(self, method: Method, written: syntax.Method | None) -> None:
        """Add the method, unless it repeats another one."""
        if method.kind == "init" and not self.is_first_init(method):
            return
        if method.kind in ("method", "loop"):
            self.check_name(method)
        signature = method.signature
        earlier = self.signatures.setdefault(signature, method) if method.kind != "init" else method
        if earlier is not method and all(p.type is not UNKNOWN for p in method.parameters):
            hint = None if "loop" not in (method.kind, earlier.kind) else "rename one of them"
            self.symbols.report(
                messages.SAME_SIGNATURE, method.span, hint=hint, signature=signature, line=earlier.span.line
            )
            return
        self.unit.add_method(method)
        if written is not None and written.loop is not None:
            add_loop(self.unit, method, written.loop)
        self.declared.bodies.append((method, written))

    def is_first_init(self, method: Method) -> bool:
        """Whether this init is the first; its shape is checked."""
        for earlier in self.unit.overloads(method.name, "init"):
            self.symbols.report(messages.DUPLICATE_INIT, method.span, line=earlier.span.line)
            return False
        types = [p.type for p in method.parameters]
        if types != [array_of(STRING)] and UNKNOWN not in types:
            self.symbols.report(messages.INIT_SHAPE, method.span)
        return True

    def check_name(self, method: Method) -> None:
        """Report a method whose bare name has another meaning."""
        check_callable_name(self.symbols, method.name, method.span)


def check_callable_name(symbols: Symbols, name: str, span: Span) -> None:
    """Report a name of a method or function that has another meaning where it is called."""
    existing = None
    if name in LIBRARY_NAMES - YIELDING:
        existing = "a library function"
    elif name.startswith("find") and symbols.resource(name[len("find") :]) is not None:
        existing = f"the find method of the resource {name[len('find') :]}"
    elif (query := parse_query_name(name)) is not None and symbols.capability(query[1]) is not None:
        existing = f"the {query[0]} method of the capability {query[1]}"
    if existing is not None:
        symbols.report(messages.METHOD_NAME_IN_USE, span, name=name, what=existing)

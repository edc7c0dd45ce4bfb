"""Calls: own methods, methods of objects, portals, find, the library, devices, and `check_new`."""

from __future__ import annotations

from collections.abc import Sequence

from lfield.lang import messages, syntax, tree
from lfield.lang.capability_port import parse_query_name
from lfield.lang.checker.conversions import (
    OverloadCandidate,
    choose_overload,
    of_methods,
    unknown,
    with_article,
)
from lfield.lang.checker.library.collection_calls import check_library_call
from lfield.lang.checker.library.enum_members import check_enum_call
from lfield.lang.checker.library.function_rules import check_limit, output_hint
from lfield.lang.checker.library.loop_members import check_loop_call
from lfield.lang.checker.library.sequencing_calls import head_call, sequencing_call
from lfield.lang.checker.library.unit_methods import function_call
from lfield.lang.checker.name_resolution import method_names
from lfield.lang.checker.queries.capability_queries import check_query
from lfield.lang.checker.scope import BodyContext
from lfield.lang.checker.symbols import BUILTIN_TYPES, EXCEPTION_NAMES, LIBRARY_NAMES, describe
from lfield.lang.checker.visibility import visible_type
from lfield.lang.language_library import (
    AREA,
    ARRAY_LIBRARY,
    EXCEPTION_METHODS,
    FUNCTIONS,
    GROWTH,
    PROXY_METHODS,
    SEQUENCED,
    STRING_METHODS,
    STRIPS,
    TICKET_METHODS,
    LibraryFunction,
    array_methods,
)
from lfield.lang.parser.foreign import foreign_words
from lfield.lang.standard_library.instances import MAP_CONSTRUCTOR
from lfield.lang.types import (
    INT,
    LIBRARY_CLASSES,
    REAL,
    STRING,
    TICKET,
    UNKNOWN,
    ArrayType,
    ClassType,
    DeviceType,
    EnumType,
    FutureType,
    MapType,
    ResourceType,
    Type,
    array_of,
)
from lfield.text.source_text import Span
from lfield.text.suggestions import choice, closest, did_you_mean


def check_bare_call(
    body: BodyContext, raw: syntax.Call, name: syntax.Name, arguments: list[tree.Expr]
) -> tree.Expr:
    """`name(arguments)`: an own method, a find or explain method, or a library function."""
    if own := body.methods(name.name):
        return _method(body, raw, name.span, body.this(name.span), own, arguments)
    if functions := body.symbols.functions.get(name.name):
        return function_call(body, raw, name.span, functions, arguments)
    resource = body.symbols.resource(name.name.removeprefix("find"))
    if resource is not None and name.name.startswith("find"):
        return find_resource(body, raw, name.span, resource, arguments)
    query = parse_query_name(name.name)
    capability = body.symbols.capability(query[1]) if query is not None else None
    if query is not None and capability is not None:
        return check_query(body, raw, name.span, query[0], capability, arguments)
    if name.name in LIBRARY_NAMES:
        return _library(body, raw, name, arguments)
    _unknown_function(body, name)
    return unknown(raw.span)


def check_member_call(
    body: BodyContext, raw: syntax.Call, function: syntax.Member, owner: tree.Expr, arguments: list[tree.Expr]
) -> tree.Expr:
    """`owner.name(arguments)`."""
    kind, name, place = owner.type, function.name, function.place
    unit = body.unit if isinstance(owner, tree.This) else body.symbols.unit_of(kind)
    if kind is UNKNOWN:
        return unknown(raw.span)
    if isinstance(owner, tree.LoopName):
        return check_loop_call(body, raw, function, owner.loop, arguments)
    if isinstance(owner, tree.EnumName) or isinstance(kind, EnumType):
        return check_enum_call(body, raw, function, owner, arguments)
    if isinstance(kind, DeviceType):
        return _device(body, raw, function, owner, arguments)
    if unit is not None:
        methods = unit.overloads(name, "portal" if isinstance(kind, ResourceType) else "method")
        if isinstance(kind, LIBRARY_CLASSES) and not body.symbols.library.parameters:
            methods = [method for method in methods if method.public]
        if methods:
            return _method(body, raw, place, owner, methods, arguments)
    if (head := head_call(body, raw, name, owner, arguments)) is not None:
        return head
    if name == "hash" and kind == STRING and body.symbols.library.parameters:
        return tree.LibraryCall(raw.span, INT, "str_hash", [owner])
    if kind == TICKET:
        return tree.LibraryCall(raw.span, *TICKET_METHODS[name], [owner])
    if isinstance(kind, ArrayType) and name in ARRAY_LIBRARY:
        return check_library_call(body, raw, owner, arguments)
    functions = _functions_of(kind, name) if unit is None or isinstance(kind, ResourceType) else []
    if functions:
        return _operation(body, raw, place, functions, arguments, owner)
    _unknown_member(body, function, kind, unit)
    return unknown(raw.span)


def check_new(body: BodyContext, raw: syntax.New, arguments: list[tree.Expr]) -> tree.Expr:
    """`check_new C(arguments)`."""
    name, place = raw.type.name, raw.type.span
    unit = body.symbols.units.get(name)
    if unit is not None and unit.capability:
        hint = f"lfield creates offers; find them: find{name}(...)"
        body.report(messages.NEW_AGENT, place, hint=hint, kind="capability", name=name)
        return unknown(raw.span)
    if unit is not None and unit.kind != "class":
        find = f"; a coordinator finds one with find{name}(...)" if unit.kind == "resource" else ""
        body.report(messages.NEW_AGENT, place, kind=unit.kind, name=name, find=find)
        return unknown(raw.span)
    if name in EXCEPTION_NAMES:
        candidates = [OverloadCandidate(name, types, None) for types in ((), (STRING,))]
        chosen = choose_overload(body.symbols, place, candidates, arguments)
        return (
            unknown(raw.span) if chosen is None else tree.New(raw.span, BUILTIN_TYPES[name], None, chosen[1])
        )
    kind = visible_type(body.symbols, body.unit, raw.type)
    if isinstance(kind, FutureType):
        body.report(messages.FUTURE_NEW, place, type=kind)
        return unknown(raw.span)
    if isinstance(kind, MapType):
        unit, name = body.symbols.unit_of(kind), MAP_CONSTRUCTOR
    if unit is None or kind is UNKNOWN:
        if kind is not UNKNOWN:
            body.report(messages.NEW_TYPE, place, given=name)
        return unknown(raw.span)
    constructor = _chosen(body, place, unit.overloads(name, "constructor"), arguments)
    return unknown(raw.span) if constructor is None else tree.New(raw.span, kind, *constructor)


def _chosen(
    body: BodyContext, place: Span, methods: Sequence[tree.Method], arguments: list[tree.Expr]
) -> tuple[tree.Method, list[tree.Expr]] | None:
    """The selected overload, if it may be called from here."""
    chosen = choose_overload(body.symbols, place, of_methods(methods), arguments)
    is_private = chosen is not None and not chosen[0].public and not body.symbols.library.parameters
    if chosen is not None and is_private and chosen[0].unit is not body.unit:
        method = chosen[0]
        body.report(messages.PRIVATE_MEMBER, place, name=method.name, owner=method.unit.name)
        return None
    return chosen


def _method(
    body: BodyContext,
    raw: syntax.Call,
    place: Span,
    owner: tree.Expr,
    methods: Sequence[tree.Method],
    operands: list[tree.Expr],
) -> tree.Expr:
    """A call of a method or, through a proxy, of a portal."""
    chosen = _chosen(body, place, methods, operands)
    if chosen is None:
        return unknown(raw.span)
    method, arguments = chosen
    if method.kind == "portal":
        return tree.PortalCall(raw.span, method.result, owner, method, arguments)
    return tree.Call(raw.span, method.result, owner, method, arguments)


def _library(body: BodyContext, raw: syntax.Call, name: syntax.Name, arguments: list[tree.Expr]) -> tree.Expr:
    """A function of the library, where its scope allows it."""
    functions = [f for f in FUNCTIONS if f.name == name.name]
    scope, side = functions[0].scope, body.unit.usage
    if scope in ("any", side):
        return _operation(body, raw, name.span, functions, arguments, None)
    if body.function:
        effect = "does input or output" if scope == "resource" else "reads the state of its coordinator"
        body.report(messages.IMPURE, name.span, function=body.method.name, what=effect)
        return unknown(raw.span)
    rule = messages.COORDINATOR_FUNCTION
    if scope == "resource":
        rule = messages.COORDINATOR_IO if side == "coordinator" else messages.GLOBAL_IO
    body.report(rule, name.span, viewer=describe(body.unit), unit=body.unit.name, name=name.name)
    return unknown(raw.span)


def _operation(
    body: BodyContext,
    raw: syntax.Call,
    place: Span,
    functions: Sequence[LibraryFunction],
    operands: list[tree.Expr],
    receiver: tree.Expr | None,
) -> tree.Expr:
    """A library function or built-in method; its receiver is the first argument of the operation."""
    candidates = [OverloadCandidate(f.name, f.parameters, f) for f in functions]
    hint = output_hint(functions[0].name, operands)
    chosen = choose_overload(body.symbols, place, candidates, operands, hint)
    if chosen is None:
        return unknown(raw.span)
    function, arguments = chosen
    check_limit(body, function.name, arguments)
    if function.operation == SEQUENCED:
        return sequencing_call(body, raw, function.name, arguments)
    everything = arguments if receiver is None else [receiver, *arguments]
    if function.operation in (AREA, STRIPS):
        # The compiler replaces the call by the values in the file.
        call = tree.LibraryCall(raw.span, REAL, function.operation, arguments)
        return tree.Elements(raw.span, function.result, [call])
    if function.operation in GROWTH:
        body.symbols.growing.add(everything[0].type)
    return tree.LibraryCall(raw.span, function.result, function.operation, everything)


def _functions_of(kind: Type, name: str) -> list[LibraryFunction]:
    """The built-in methods of that name."""
    if isinstance(kind, ArrayType):
        methods = array_methods(kind)
    elif kind == STRING:
        methods = STRING_METHODS
    elif isinstance(kind, ResourceType):
        methods = PROXY_METHODS
    else:
        methods = EXCEPTION_METHODS if isinstance(kind, ClassType) else ()
    return [f for f in methods if f.name == name]


def _device(
    body: BodyContext, raw: syntax.Call, function: syntax.Member, owner: tree.Expr, arguments: list[tree.Expr]
) -> tree.Expr:
    """`fc.instruction(arguments)`: of a device of the resource, or of one passed to an object."""
    manifest = body.symbols.devices[owner.type.name]
    instruction = manifest.instruction(function.name)
    if instruction is None:
        _unknown_member(body, function, owner.type, None)
        return unknown(raw.span)
    types = tuple(_manifest_type(p.type) for p in instruction.parameters)
    candidate = OverloadCandidate(instruction.name, types, instruction)
    chosen = choose_overload(body.symbols, function.place, [candidate], arguments)
    if chosen is None:
        return unknown(raw.span)
    result = _manifest_type(instruction.result)
    own = body.unit.kind == "resource" and isinstance(owner, tree.FieldGet) and _is_own(owner)
    field = owner.field if isinstance(owner, tree.FieldGet) and own else None
    return tree.DeviceCall(raw.span, result, field or owner, manifest, instruction, chosen[1])


def _is_own(device: tree.FieldGet) -> bool:
    return isinstance(device.object, tree.This)


def _manifest_type(name: str) -> Type:
    """The L type of a manifest's type name (`real[]`)."""
    element = BUILTIN_TYPES[name.removesuffix("[]")]
    return array_of(element) if name.endswith("[]") else element


def _unknown_function(body: BodyContext, name: syntax.Name) -> None:
    """Report a bare call of a name that is neither an own method nor a function."""
    called = name.name
    unit = body.symbols.units.get(called)
    if body.unit.overloads(called, "portal"):
        body.report(messages.PORTAL_INSIDE, name.span, name=called)
    elif body.unit.loop(called) is not None:
        body.report(messages.LOOP_CALL, name.span, name=called)
    elif unit is not None or called in EXCEPTION_NAMES:
        may_be_made = unit is None or unit.kind == "class"
        instead = f"make an object: new {called}(...)" if may_be_made else "agents come from the deployment"
        body.report(messages.TYPE_AS_VALUE, name.span, name=called, instead=instead)
    elif body.scope.find(called) is not None or body.field(called) is not None:
        body.report(messages.NOT_A_METHOD, name.span, name=called)
    elif not (
        body.is_broken() or body.symbols.missing or (body.symbols.incomplete and called.startswith("find"))
    ):
        body.report(messages.UNKNOWN_FUNCTION, name.span, hint=_function_hint(body, called), name=called)


def _function_hint(body: BodyContext, called: str) -> str | None:
    if called in foreign_words.FOREIGN_FUNCTIONS:
        return foreign_words.FOREIGN_FUNCTIONS[called]
    own = [] if body.function else [m.name for m in body.unit.methods if m.kind == "method"]
    own += body.symbols.functions
    finds = find_names(body) if body.unit.usage == "coordinator" else []
    keyword = closest(called, ("if", "while", "for", "return", "catch"))
    return did_you_mean(called, [*own, *finds, *LIBRARY_NAMES]) or (
        f"did you mean {keyword} ?" if keyword else None
    )


def _foreign_method(kind: Type, name: str) -> str | None:
    """The correct form of a method that text and arrays have in other languages."""
    if kind == STRING:
        return foreign_words.STRING_METHODS.get(name)
    if isinstance(kind, MapType):
        return foreign_words.MAP_METHODS.get(name)
    return foreign_words.ARRAY_METHODS.get(name) if isinstance(kind, ArrayType) else None


def _unknown_member(body: BodyContext, function: syntax.Member, kind: Type, unit: tree.Unit | None) -> None:
    """Report a call of a member that the receiver does not have."""
    name, place = function.name, function.place
    if unit is not None and isinstance(kind, ResourceType):
        if unit.overloads(name, "method"):
            body.report(messages.ONLY_PORTALS, place, name=name, resource=unit.name)
            return
    elif unit is not None and unit.overloads(name, "portal"):
        body.report(messages.PORTAL_INSIDE, place, name=name)
        return
    if unit is not None and unit.name in body.symbols.broken_units:
        return
    if unit is not None and not isinstance(kind, ResourceType) and unit.field(name) is not None:
        body.report(messages.NOT_A_METHOD, place, name=name)
        return
    known = method_names(body, kind, unit)
    if not known and unit is None:
        body.report(messages.NO_MEMBERS, place, given=with_article(kind))
        return
    member_kind = {ResourceType: "portal", DeviceType: "instruction"}.get(type(kind), "method")
    listing = choice(name, known, "it has") if known else f"it has no {member_kind}s"
    hint = _foreign_method(kind, name) or did_you_mean(name, known) or listing
    body.report(
        messages.UNKNOWN_METHOD, place, hint=hint, type=kind, kind=member_kind, name=name, known=listing
    )


# --- finding resources: findR(...) ----------------------------------------------------------------------


def find_resource(
    body: BodyContext, raw: syntax.Call, place: Span, resource: tree.Unit, operands: list[tree.Expr]
) -> tree.Expr:
    """`findR(id)` or `findR()`; only where resources are visible."""
    if body.unit.usage != "coordinator":
        body.report(messages.FIND_PLACE, place, viewer=describe(body.unit), what="resources")
        return unknown(raw.span)
    proxy = ResourceType(resource.name)
    name = f"find{resource.name}"
    candidates: list[OverloadCandidate[Type]] = [
        OverloadCandidate(name, (STRING,), proxy),
        OverloadCandidate(name, (), array_of(proxy)),
    ]
    chosen = choose_overload(body.symbols, place, candidates, operands)
    if chosen is None:
        return unknown(raw.span)
    kind, arguments = chosen
    if arguments and isinstance(arguments[0], tree.Literal_) and arguments[0].value == "":
        body.report(messages.EMPTY_ID, arguments[0].span, name=name)
    return tree.Find(raw.span, kind, resource, arguments[0] if arguments else None)


def find_names(body: BodyContext) -> list[str]:
    """The names of all find methods in this program, for hints."""
    capabilities = body.symbols.capability_names()
    found = [f"find{name}" for name in (*body.symbols.resource_names(), *capabilities)]
    return [*found, *(f"{verb}{name}" for name in capabilities for verb in ("explain", "teams"))]

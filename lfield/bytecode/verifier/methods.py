"""Verifies method records: signatures, code ranges, portal arguments, and debug information."""

from __future__ import annotations

from collections.abc import Mapping

from lfield.bytecode.program import (
    ANY,
    ARRAY,
    ARRAYS,
    DEVICE,
    OBJECT,
    PROXY,
    STRING,
    TICKET,
    VOID,
    Core,
    MethodDebug,
    MethodRecord,
    Program,
    TypeRecord,
)
from lfield.bytecode.verifier.type_table import TypeTable, scope_of
from lfield.errors import ProgramFileError

#: The maximum number of slots of an activation record: parameters, locals and temporaries.
MAX_SLOTS = 4096
#: Bytes of one quad in the code.
QUAD_SIZE = 16

#: For each kind of method, the kinds of its owners.
_OWNERS = {
    "method": frozenset({"class", "resource", "coordinator"}),
    "constructor": frozenset({"class"}),
    "init": frozenset({"resource", "coordinator"}),
    "portal": frozenset({"resource"}),
    "loop": frozenset({"resource"}),
    "ticks": frozenset({"resource"}),
}
#: The body of a loop, and the method of its thread.
_OF_LOOPS = ("loop", "ticks")
#: Kinds in slots other than values, by the scope of the method.
_NON_VALUE_KINDS = {"resource": frozenset({DEVICE}), "coordinator": frozenset({TICKET})}


def check_methods(core: Core) -> None:
    """Check that every method has a valid record, and that together they cover the code without gap or
    overlap.
    """
    table = TypeTable(core)
    at = 0
    for method in core.methods:
        if method.entry != at or method.end <= method.entry:
            raise ProgramFileError(f"there is a gap or an overlap before instruction {method.entry}")
        at = method.end
        _check_shape(core, table, method)
    if len(core.code) != at * QUAD_SIZE:
        raise ProgramFileError("its code is longer or shorter than its methods")
    _check_inits(core)
    _check_portals(core)


def _check_shape(core: Core, table: TypeTable, method: MethodRecord) -> None:
    if not method.name.isidentifier():
        raise ProgramFileError(f"a method has the name {method.name!r}, which is not an identifier")
    if not core.builtins <= method.owner < len(core.classes):
        raise _refused(method, "it belongs to no class of the program")
    if core.classes[method.owner].kind not in _OWNERS.get(method.kind, ()):
        raise _refused(method, f"its class cannot have a method of kind {method.kind!r}")
    if not 0 <= method.parameters < len(method.slots) <= MAX_SLOTS:
        raise _refused(method, f"it has {len(method.slots)} slots and {method.parameters} parameters")
    if not all(map(table.has, method.slots)) or not table.has(method.result):
        raise _refused(method, "it uses a type that does not exist")
    if table.record(method.slots[0]) != TypeRecord(OBJECT, method.owner):
        raise _refused(method, "its slot 0 is not the object it runs on")
    kinds = (core.types[i].kind for i in method.slots[1:] if not table.is_value(i))
    if not _NON_VALUE_KINDS.get(scope_of(core.classes[method.owner]), frozenset()).issuperset(kinds):
        raise _refused(method, "a slot has a type no variable can have")
    if method.result != VOID and not table.is_value(method.result):
        raise _refused(method, "it has a result of a type no value can have")
    if method.kind in ("constructor", *_OF_LOOPS) and method.result != VOID:
        raise _refused(method, f"it is a {method.kind} and has a result")
    if method.kind in _OF_LOOPS and (method.parameters or method.synchronized):
        raise _refused(method, "it is of a loop, and has parameters or the monitor")


def _check_inits(core: Core) -> None:
    """Check that resources and coordinators have one init each, from string[] to nothing, and classes have
    none.
    """
    for index, method in enumerate(core.methods):
        if method.kind != "init":
            continue
        if core.classes[method.owner].init != index:
            raise _refused(method, "it is not the init that its class names")
        arguments = [core.types[core.plain_array(slot)] for slot in method.slots[1 : method.parameters + 1]]
        if arguments != [TypeRecord(ARRAY, STRING)] or method.result != VOID:
            raise _refused(method, "it is an init and does not take string[] to nothing")
    for record in core.classes[core.builtins :]:
        if record.kind == "class":
            if record.init != -1:
                raise ProgramFileError(f"class {record.name} has an init")
        elif not 0 <= record.init < len(core.methods) or core.methods[record.init].kind != "init":
            raise ProgramFileError(f"{record.name} has no init")


def _check_portals(core: Core) -> None:
    """Check that types of one side do not cross a portal, at any depth in an argument.

    All portals share the visited set, so each type is checked once.
    """
    visited: set[int] = set()
    suppressed_fields = core.others
    for method in core.methods:
        if method.kind != "portal":
            continue
        open_types = [method.result, *method.slots[1 : method.parameters + 1]]
        while open_types:
            index = open_types.pop()
            if index in visited:
                continue
            visited.add(index)
            if not _may_cross(core, core.types[index]):
                raise _refused(method, f"it is a portal, and type {index} cannot cross one")
            open_types.extend(_parts(core, core.types[index], suppressed_fields))


def _may_cross(core: Core, record: TypeRecord) -> bool:
    if record.kind in (ANY, PROXY, DEVICE):
        return False
    return record.kind != OBJECT or core.classes[record.of].usage == "global"


def _parts(core: Core, record: TypeRecord, suppressed_fields: Mapping[int, int]) -> list[int]:
    if record.kind in ARRAYS:
        return [record.of]
    if record.kind != OBJECT:
        return []
    # Suppressed exceptions of a `together` are not copied when an exception crosses a portal (copier.py).
    fields = core.classes[record.of].fields
    return [field.type for i, field in enumerate(fields) if i != suppressed_fields.get(record.of)]


def check_debug(program: Program) -> None:
    """Check debug information, which is optional: it has one valid entry per method."""
    debug, methods = program.debug, program.core.methods
    if debug.methods and len(debug.methods) != len(methods):
        raise ProgramFileError("its debug information does not match its methods")
    for info, method in zip(debug.methods, methods, strict=False):
        if not 0 <= info.source < len(debug.sources):
            raise _refused(method, "a method has no source file")
        _check_entry(info, method)


def _check_entry(info: MethodDebug, method: MethodRecord) -> None:
    before = method.entry - 1
    for pc, line in info.lines:
        if not before < pc < method.end or line < 1:
            raise _refused(method, "its lines are out of order")
        before = pc
    if not all(0 <= slot < len(method.slots) for slot, _ in info.names):
        raise _refused(method, "it names a slot that does not exist")


def _refused(method: MethodRecord, reason: str) -> ProgramFileError:
    return ProgramFileError(reason, method=method.name, pc=method.entry)

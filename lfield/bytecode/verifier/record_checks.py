"""Verifies types, classes, constants and device calls."""

from __future__ import annotations

import re
from collections.abc import Sequence

from lfield.bytecode.program import (
    ANY,
    ARRAY,
    ARRAYS,
    BUILTIN_CLASSES,
    DEVICE,
    EXCEPTIONS,
    FACT_FIELDS,
    FACTS,
    GROWABLE,
    HELD_DEVICE,
    INT,
    OBJECT,
    OLDEST_BUILTINS,
    OLDEST_FACTS,
    PROXY,
    REAL,
    STRING,
    TICKET,
    VOID,
    ClassRecord,
    Core,
    DeviceField,
    FieldRecord,
    TypeRecord,
)
from lfield.bytecode.verifier.type_table import TypeTable, scope_of
from lfield.errors import ProgramFileError

#: The first types of every program: eight without parts, and the arrays of `others()`.
FIXED_TYPES = (*(TypeRecord(kind) for kind in range(8)), TypeRecord(ARRAY, ANY))
assert FIXED_TYPES[EXCEPTIONS] == TypeRecord(ARRAY, ANY)

_TEXT_FIELDS = tuple(FieldRecord(name, STRING) for name in ("message", "source", "trace"))
_EXCEPTION_FIELDS = (*_TEXT_FIELDS, FieldRecord("others", EXCEPTIONS))
#: The built-in exception classes, exactly as every program has them.
BUILTIN_RECORDS = tuple(ClassRecord(name, "class", "global", _EXCEPTION_FIELDS) for name in BUILTIN_CLASSES)
#: The first types of a program of lfield 0.3.
_OLD_TYPES = FIXED_TYPES[:EXCEPTIONS]
_OLD_RECORDS = tuple(
    ClassRecord(name, "class", "global", _TEXT_FIELDS) for name in BUILTIN_CLASSES[:OLDEST_BUILTINS]
)

_TEXT, _NUMBER, _COUNT = TypeRecord(STRING), TypeRecord(REAL), TypeRecord(INT)
_TEXTS, _NUMBERS = TypeRecord(ARRAY, STRING), TypeRecord(ARRAY, REAL)
_FACT_TYPES = (
    *(_TEXT, _TEXT, _TEXT, _NUMBER, _TEXTS, _NUMBERS, _TEXTS, _NUMBERS),
    *(_COUNT, _TEXT, _TEXTS, _NUMBER),
)
_FACT_SHAPE = list(zip(FACT_FIELDS, _FACT_TYPES, strict=True))

#: The field of a loop of a resource: no name of a program refers to it.
_LOOP_FIELD = re.compile(r"[A-Za-z_]\w*\.(running|engaged|overruns)", re.ASCII)
#: The name of a class of maps or futures is its type.
_LIBRARY_NAME = re.compile(r"(map|future)<[\w<>, \[\]]+>")
_INT_MIN, _INT_MAX = -(1 << 63), (1 << 63) - 1
_KINDS = frozenset({"class", "resource", "coordinator"})
_USAGES = frozenset({"global", "resource", "coordinator"})
_EFFECTS = frozenset({"query", "idempotent", "actuate"})


def check_types(core: Core) -> None:
    """Check the types: first the fixed ones, then arrays of earlier types, objects and proxies; no
    duplicates.
    """
    old = core.builtins == OLDEST_BUILTINS
    fixed = _OLD_TYPES if old else FIXED_TYPES
    if core.types[: len(fixed)] != fixed:
        raise ProgramFileError("its first types are not those of every program")
    if len(set(core.types)) != len(core.types):
        raise ProgramFileError("a type is in its table twice")
    if core.classes[: core.builtins] != (_OLD_RECORDS if old else BUILTIN_RECORDS):
        raise ProgramFileError("its first classes are not the built-in exceptions")
    table = TypeTable(core)
    for index in range(len(fixed), len(core.types)):
        _check_type(core, table, index)


def _check_type(core: Core, table: TypeTable, index: int) -> None:
    record = core.types[index]
    if record.kind == ARRAY:
        # Elements have an earlier type, so arrays cannot be recursive.
        if not (0 <= record.of < index and table.is_value(record.of)):
            raise ProgramFileError(
                f"type {index} is an array whose element type is not an earlier type of values"
            )
    elif record.kind == GROWABLE:
        if not (0 <= record.of < index and core.types[record.of].kind == ARRAY):
            raise ProgramFileError(f"type {index} is an array that grows, and its elements are in no array")
    elif record.kind in (OBJECT, PROXY):
        if not 0 <= record.of < len(core.classes):
            raise ProgramFileError(f"type {index} is of class {record.of}, which does not exist")
        if record.kind == PROXY and core.classes[record.of].kind != "resource":
            raise ProgramFileError(f"type {index} is a proxy for something that is not a resource")
    elif record.kind == INT:
        if not (core.builtins <= record.of < len(core.classes) and _is_enum(core.classes[record.of])):
            raise ProgramFileError(f"type {index} is an enum of class {record.of}, which has no members")
    elif record != TypeRecord(TICKET):
        raise ProgramFileError(f"type {index} is of unknown kind {record.kind}")


def _is_enum(record: ClassRecord) -> bool:
    """Whether a class can have the members of an enum: their names as its fields."""
    return record.kind == "class" and bool(record.fields) and all(f.type == INT for f in record.fields)


def check_classes(core: Core) -> None:
    """Check names, kinds, fields and devices of classes; `init` is checked with the methods."""
    names = [record.name for record in core.classes]
    if len(set(names)) != len(names):
        raise ProgramFileError("two of its classes have the same name")
    table = TypeTable(core)
    others = core.others
    for index, record in enumerate(core.classes[core.builtins :], core.builtins):
        if not (record.name.isidentifier() or _LIBRARY_NAME.fullmatch(record.name)):
            raise ProgramFileError(f"a class has the name {record.name!r}, which is not an identifier")
        if record.kind not in _KINDS or record.usage not in _USAGES:
            raise ProgramFileError(f"{record.name} is of unknown kind {record.kind!r}, {record.usage!r}")
        _check_fields(record, table, record.fields[:-1] if index in others else record.fields)
        if index in others:
            _check_suppressed(record)


def _check_suppressed(record: ClassRecord) -> None:
    """Check the field for suppressed exceptions, which the machine writes and portals do not copy."""
    if record.kind != "class" or record.capability or record.fields[-1].type != EXCEPTIONS:
        raise ProgramFileError(f"{record.name} has no field for suppressed exceptions")


def _check_fields(record: ClassRecord, table: TypeTable, fields: Sequence[FieldRecord]) -> None:
    for field in fields:
        if not (field.name.isidentifier() or _LOOP_FIELD.fullmatch(field.name)):
            raise ProgramFileError(f"a field of {record.name} has the name {field.name!r}")
        special = table.has(field.type) and (field.type == DEVICE or _may_hold_ticket(record, table, field))
        if not table.has(field.type) or not (special or table.is_value(field.type)):
            raise ProgramFileError(f"field {record.name}.{field.name} has a type no field can have")
    if record.capability:
        _check_capability(record, table)
    devices = [field.name for field in record.fields if field.type == DEVICE]
    known = devices if record.kind == "resource" else []
    if known != [device.name for device in record.devices]:
        raise ProgramFileError(f"the devices of {record.name} are not its device fields")
    if devices and scope_of(record) != "resource":
        raise ProgramFileError(f"{record.name} has a device and is not a resource")


def _may_hold_ticket(record: ClassRecord, table: TypeTable, field: FieldRecord) -> bool:
    """Whether `field` is the field of a future: the call, in an object of a coordinator."""
    is_future = record.kind == "class" and record.usage == "coordinator"
    return table.kind(field.type) == TICKET and is_future


def _check_capability(record: ClassRecord, table: TypeTable) -> None:
    """Check the layout of a class of offers, which the machine creates."""
    if (record.kind, record.usage) != ("class", "coordinator"):
        raise ProgramFileError(f"the capability {record.name} is not a coordinator specific class")
    facts = table.fields(record.fields[0].type) if record.fields else ()
    fields = [(field.name, _plain(table, field.type)) for field in facts]
    if fields not in (_FACT_SHAPE, _FACT_SHAPE[:OLDEST_FACTS]) or record.fields[0].name != FACTS:
        raise ProgramFileError(f"the capability {record.name} does not start with the fields of offers")


def _plain(table: TypeTable, index: int) -> TypeRecord:
    """A type; for a growable array, the type of the ARRAY with its elements."""
    record = table.record(index)
    return table.record(record.of) if record.kind == GROWABLE else record


def check_constants(core: Core) -> None:
    """Check the constants: ints within 64 bits; the other kinds are limited by their encoding."""
    for number, value in enumerate(core.constants):
        if type(value) is int and not _INT_MIN <= value <= _INT_MAX:
            raise ProgramFileError(f"constant {number} is an int beyond 64 bits")


def check_device_calls(core: Core) -> None:
    """Check that each device call names a device of a resource, and only values that may be passed to a
    driver.
    """
    values = {i for i in range(len(core.types)) if _is_device_value(core, i)}
    results = {VOID, *values}
    devices = {(i, device) for i, record in enumerate(core.classes) for device in record.devices}
    for number, call in enumerate(core.device_calls):
        if call.field == HELD_DEVICE:
            if not 0 <= call.owner < len(core.classes) or scope_of(core.classes[call.owner]) != "resource":
                raise ProgramFileError(f"device call {number} is of a class without resource")
        elif (call.owner, DeviceField(call.field, call.device)) not in devices:
            raise ProgramFileError(f"device call {number} names a device its resource does not have")
        if call.effect not in _EFFECTS:
            raise ProgramFileError(f"device call {number} has the unknown effect {call.effect!r}")
        if not values.issuperset(call.parameters) or call.result not in results:
            raise ProgramFileError(
                f"device call {number} has an argument or result of a type that drivers do not support"
            )


def _is_device_value(core: Core, index: int) -> bool:
    """Whether `index` is a type of manifest.DEVICE_VALUE_TYPES."""
    kind = core.types[index].kind
    return kind in range(1, STRING + 1) or (kind in ARRAYS and core.element(index) in (INT, REAL))

"""The first pass: types, classes, methods and their indexes, before any code is generated."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

from lfield.bytecode.program import (
    ANY,
    ARRAY,
    BOOLEAN,
    BUILTIN_CLASSES,
    DEVICE,
    EXCEPTIONS,
    GROWABLE,
    HELD_DEVICE,
    INT,
    OBJECT,
    PROXY,
    REAL,
    STRING,
    SUPPRESSED_FIELD,
    TICKET,
    VOID,
    ClassRecord,
    DeviceCallRecord,
    DeviceField,
    FieldRecord,
    TypeRecord,
)
from lfield.bytecode.verifier.record_checks import BUILTIN_RECORDS, FIXED_TYPES
from lfield.compiler.async_variants.async_methods import async_variants_of
from lfield.compiler.async_variants.effect_analysis import EffectAnalysis
from lfield.compiler.constant_folding import ConstantPool
from lfield.lang import tree, types
from lfield.lang.types import ArrayType, ClassType, DeviceType, EnumType, ResourceType, Type

_SIMPLE = {
    types.VOID: VOID,
    types.BOOLEAN: BOOLEAN,
    types.INT: INT,
    types.REAL: REAL,
    types.STRING: STRING,
    types.EXCEPTION: ANY,
    # A variable of only null, as in `throw null`, may be of any class.
    types.NULL: ANY,
}

#: The types of manifest.DEVICE_VALUE_TYPES, and the type of no result.
_DEVICE_TYPES = {
    str(kind): kind
    for kind in (
        types.VOID,
        types.BOOLEAN,
        types.INT,
        types.REAL,
        types.STRING,
        types.array_of(types.REAL),
        types.array_of(types.INT),
    )
}


class ProgramTables:
    """The tables of a program, filled by the first pass and, for types and constants, on demand.

    `growing` are the types of arrays that the program makes longer or shorter.
    """

    def __init__(
        self,
        units: list[tree.Unit],
        growing: Collection[Type] = (),
        enums: Sequence[tree.Enumeration] = (),
    ) -> None:
        self._growing = growing
        self.pool = ConstantPool()
        self.types: list[TypeRecord] = list(FIXED_TYPES)
        self.device_calls: list[DeviceCallRecord] = []
        written = [method for unit in units for method in (*unit.methods, *unit.library_methods)]
        has_futures = any(unit.name.startswith("future<") for unit in units)
        self._async_variants = async_variants_of(written, has_futures=has_futures)
        self._tickets = {twin.method: twin.ticket for twin in self._async_variants.values()}
        self.methods = [*written, *self._tickets]
        self.effect_analysis = EffectAnalysis(written)
        self._type_indexes: dict[TypeRecord, int] = {record: i for i, record in enumerate(self.types)}
        self._device_indexes: dict[DeviceCallRecord, int] = {}
        self._methods = {method: i for i, method in enumerate(self.methods)}
        names = [*BUILTIN_CLASSES, *(unit.name for unit in units), *(enum.name for enum in enums)]
        self._classes = {name: i for i, name in enumerate(names)}
        self.classes = [*BUILTIN_RECORDS, *map(self._class_record, units), *map(_enum_record, enums)]

    def class_index(self, name: str) -> int:
        """The index of a class, resource or coordinator."""
        return self._classes[name]

    def method_index(self, method: tree.Method) -> int:
        return self._methods[method]

    def async_variant(self, method: tree.Method) -> tree.Method:
        """The method that a `together` calls instead of a method of an offer."""
        return self._async_variants[method].method

    def ticket_of(self, method: tree.Method) -> tree.Local | None:
        """The parameter of an asynchronous variant that has the ticket of its caller's `together`."""
        return self._tickets.get(method)

    @property
    def ticket_type(self) -> int:
        """The type of a ticket of a `together`."""
        return self.type_index(types.TICKET)

    def type_index(self, kind: Type) -> int:
        """The index of a type; its record is added at the first use."""
        if kind in _SIMPLE:
            return _SIMPLE[kind]
        match kind:
            case ArrayType():
                plain = self.plain_array_type(kind.element)
                return self._type(TypeRecord(GROWABLE, plain)) if kind in self._growing else plain
            case ClassType():
                return self.object_type(kind.name)
            case EnumType():
                return self._type(TypeRecord(INT, self.class_index(kind.name)))
            case ResourceType():
                return self._type(TypeRecord(PROXY, self.class_index(kind.name)))
            case DeviceType():
                return DEVICE
            case types.TICKET:
                return self._type(TypeRecord(TICKET))
        raise AssertionError(f"the checker let the type {kind} through")

    def plain_array_type(self, element: Type) -> int:
        """The type of an array that never grows."""
        return self._type(TypeRecord(ARRAY, self.type_index(element)))

    def object_type(self, name: str) -> int:
        """The type of the objects of a class, or of an agent's own object."""
        return self._type(TypeRecord(OBJECT, self.class_index(name)))

    def device_call(self, call: tree.DeviceCall, owner: tree.Unit) -> int:
        """The index of an instruction of a device field, without duplicates."""
        row = DeviceCallRecord(
            self.class_index(owner.name),
            call.device.name if isinstance(call.device, tree.Field) else HELD_DEVICE,
            call.manifest.type,
            call.instruction.name,
            tuple(self.type_index(_DEVICE_TYPES[p.type]) for p in call.instruction.parameters),
            self.type_index(_DEVICE_TYPES[call.instruction.result]),
            call.instruction.effect,
        )
        if row not in self._device_indexes:
            self._device_indexes[row] = len(self.device_calls)
            self.device_calls.append(row)
        return self._device_indexes[row]

    def _type(self, record: TypeRecord) -> int:
        if record not in self._type_indexes:
            self._type_indexes[record] = len(self.types)
            self.types.append(record)
        return self._type_indexes[record]

    def _fields(self, unit: tree.Unit) -> Iterator[FieldRecord]:
        """The fields, and a last one for suppressed exceptions of an object that may be thrown."""
        yield from (FieldRecord(field.name, self.type_index(field.type)) for field in unit.fields)
        if unit.thrown and not unit.capability:
            yield FieldRecord(SUPPRESSED_FIELD, EXCEPTIONS)

    def _class_record(self, unit: tree.Unit) -> ClassRecord:
        inits = (self._methods[method] for method in unit.methods if method.kind == "init")
        return ClassRecord(
            unit.name,
            unit.kind,
            unit.usage,
            tuple(self._fields(unit)),
            next(inits, -1),
            tuple(
                DeviceField(f.name, f.type.name)
                for f in unit.fields
                if isinstance(f.type, DeviceType) and unit.kind == "resource"
            ),
            unit.capability,
        )


def _enum_record(enum: tree.Enumeration) -> ClassRecord:
    """The names of the members, for listings and debuggers: no object has this class."""
    return ClassRecord(enum.name, "class", "global", tuple(FieldRecord(name, INT) for name in enum.members))

"""A program: the compiler's output and the machine's input, as plain records.

References between records are indexes. The records are msgspec structs encoded as arrays, so the same
program is always the same bytes: their SHA-256 is its identity. Debug information is not part of the
identity: the location of the sources does not change the behaviour of a robot.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from functools import cached_property
from typing import Literal, NamedTuple

import msgspec

from lfield.bytecode.opcodes import BY_NAME

# Kinds of types. The first eight types of every program are the types without parts, at these indexes.
VOID, BOOLEAN, INT, REAL, STRING, ANY, NULL, DEVICE = range(8)
ARRAY, OBJECT, PROXY = 8, 9, 10
#: A call of a `together`, or the sentinel of its calls: only in slots of coordinators.
TICKET = 11
#: An array that the program appends to or removes from; `of` is the type of an ARRAY, which has the elements.
GROWABLE = 12

#: Kinds whose values are references into the block.
REFERENCES = frozenset({STRING, ANY, NULL, ARRAY, OBJECT, PROXY, TICKET, GROWABLE})
#: Kinds of types that have elements.
ARRAYS = frozenset({ARRAY, GROWABLE})

#: The ninth type of every program: arrays of any objects, the result of `others()`.
EXCEPTIONS = 8

#: The built-in exception classes are the first classes of every program, in this order. Their objects have
#: four fields: message, source and trace, all strings, and the exceptions of other calls of a `together`.
#: `Exception` itself is index 0. A program of lfield 0.3 has fewer of them, with the first three fields.
BUILTIN_CLASSES = (
    "Exception",
    "UnreachableResourceException",
    "RestartException",
    "UnknownResourceException",
    "NullException",
    "IndexException",
    "ArithmeticException",
    "ConversionException",
    "LimitException",
    "DeviceException",
    "DeviceTimeoutException",
    "ConstraintException",
    "MissingReturnException",
    "CancelledException",
    "TimeLimitException",
    "ReservedException",
    "ReservationLostException",
    "AccessException",
)
#: The parent of a built-in class, if it is not `Exception`: a catch of the parent catches both.
BUILTIN_PARENTS = {"DeviceTimeoutException": "DeviceException"}
#: The number of built-in classes in a program of lfield 0.3. Later ones are only appended.
OLDEST_BUILTINS = 12
MESSAGE, SOURCE, TRACE, OTHERS = 0, 1, 2, 3
#: The name of the last field of a class of the program whose objects may be thrown: its suppressed
#: exceptions.
SUPPRESSED_FIELD = ""

#: The first field of a capability, and the fields of its class: the attributes of an offer. `names`,
#: `numbers`, `texts`, `ages` and `sources` have one element for each attribute.
FACTS = "facts"
FACT_FIELDS = (
    *("agent", "host", "way", "score", "names", "numbers", "texts", "ages"),
    *("found", "note", "sources", "since"),
)
#: The number of these fields in a program of lfield 0.4. Later ones are only appended.
OLDEST_FACTS = 8

UnitKind = Literal["class", "resource", "coordinator"]

#: The name of the sources of the library that is written in L; traces omit their lines.
LIBRARY_SOURCE = "<library>"

_QUAD = struct.Struct("<4i")
_SEQ_STOP = BY_NAME["seq_stop"].code


class Quad(NamedTuple):
    """One instruction: opcode and three operands (unused ones are 0)."""

    op: int
    a: int
    b: int
    c: int


class TypeRecord(msgspec.Struct, frozen=True, array_like=True):
    """A type: its kind, and the element type of an ARRAY, the ARRAY of a GROWABLE, or the class of an OBJECT
    or PROXY.

    An INT with a class is an enum: an int like any other to the machine. The class has its members as fields.
    """

    kind: int
    of: int = 0


class FieldRecord(msgspec.Struct, frozen=True, array_like=True):
    """A field: name and type index. A device field has type DEVICE; its word is unused."""

    name: str
    type: int

    @property
    def is_hidden(self) -> bool:
        """Whether no name of a program refers to the field: a field of a loop, or for suppressed
        exceptions.
        """
        return not self.name.isidentifier()


class DeviceField(msgspec.Struct, frozen=True, array_like=True):
    """A device of a resource: the field's name and the device type's name."""

    name: str
    type: str


class ClassRecord(msgspec.Struct, frozen=True, array_like=True):
    """A class, resource or coordinator. `init` is a method index, -1 for classes.

    The objects of a `capability` are offers, which only the machine creates: the first field is FACTS, each
    other field represents one realisation.
    """

    name: str
    kind: UnitKind
    usage: Literal["global", "resource", "coordinator"]
    fields: tuple[FieldRecord, ...] = ()
    init: int = -1
    devices: tuple[DeviceField, ...] = ()
    capability: bool = False


#: Kinds of handlers. CATCH catches objects of its class; FINALLY catches any object, and throws it again at
#: its end. The other kinds catch no object. LIMIT: `slot` has the end of a `within` in ns on the agent's
#: clock, NO_LIMIT before it is set, and the negated end after it has expired. LANDING: the code of a
#: `finally`, where an enclosing limit does not skip catches. RESERVED: `slot` has the resources of a
#: `reserve`, an array of alternating team members and reservation numbers.
CATCH, FINALLY, LIMIT, LANDING, RESERVED = range(5)
#: The value in the slot of a LIMIT before it is set.
NO_LIMIT = 0


class Handler(msgspec.Struct, frozen=True, array_like=True):
    """Instructions start..end-1 are protected; `catches` is a class index (0, Exception, matches any object).

    `target` and `catches` are 0 for kinds that catch no object, and so is the slot of a LANDING.
    """

    start: int
    end: int
    target: int
    catches: int
    slot: int
    kind: int = CATCH


class MethodRecord(msgspec.Struct, frozen=True, array_like=True):
    """A subroutine: instructions entry..end-1. Slot 0 is the object; slots 1..parameters its arguments.

    `slots` are the type indexes of all slots; `result` a type index (VOID for none). `kind` is "method",
    "constructor", "init", "portal", "loop" (its body) or "ticks" (its thread). Handlers are ordered innermost
    first.
    """

    name: str
    owner: int
    kind: str
    parameters: int
    result: int
    slots: tuple[int, ...]
    entry: int
    end: int
    synchronized: bool = False
    handlers: tuple[Handler, ...] = ()


#: The field in the call of a device that an object holds: the device is the first pushed value.
HELD_DEVICE = ""


class DeviceCallRecord(msgspec.Struct, frozen=True, array_like=True):
    """One instruction of a device field that the program uses, or of a device that objects have (HELD).

    A device value is the position of the device among those of its resource, from 1; 0 is none.
    """

    owner: int  # class index of the resource, or of its class
    field: str
    device: str
    instruction: str
    parameters: tuple[int, ...]
    result: int
    effect: str  # "query", "idempotent", "actuate"


class MethodDebug(msgspec.Struct, frozen=True, array_like=True):
    """The source of a method: (pc, line) of each statement, by rising pc, and (slot, name) of its named
    slots."""

    source: int
    lines: tuple[tuple[int, int], ...]
    names: tuple[tuple[int, str], ...]
    signature: str


class SourceText(msgspec.Struct, frozen=True, array_like=True):
    """A source file: its displayed name, and its text."""

    name: str
    text: str


class Debug(msgspec.Struct, frozen=True, array_like=True):
    """Debug information: one entry per method, and the sources."""

    methods: tuple[MethodDebug, ...]
    sources: tuple[SourceText, ...]


class Core(msgspec.Struct, frozen=True, array_like=True):
    """The part of a program that determines its identity."""

    types: tuple[TypeRecord, ...]
    constants: tuple[bool | int | float | str | None, ...]
    classes: tuple[ClassRecord, ...]
    methods: tuple[MethodRecord, ...]
    device_calls: tuple[DeviceCallRecord, ...]
    code: bytes

    def plain_array(self, index: int) -> int:
        """The type of the ARRAY with the elements of an array type: for a GROWABLE, its second type."""
        record = self.types[index]
        return record.of if record.kind == GROWABLE else index

    def element(self, index: int) -> int:
        """The type of the elements of an array type."""
        return self.types[self.plain_array(index)].of

    def created_arrays(self) -> dict[int, int]:
        """By element type, the type of arrays that the machine creates: a growable one, if there is one."""
        plain = {record.of: i for i, record in enumerate(self.types) if record.kind == ARRAY}
        growing = {
            self.types[record.of].of: i for i, record in enumerate(self.types) if record.kind == GROWABLE
        }
        return plain | growing

    def enum_members(self, index: int) -> tuple[str, ...]:
        """The names of the members of an enum by the index of its type; () for any other type."""
        record = self.types[index]
        is_enum = record.kind == INT and record.of
        return tuple(field.name for field in self.classes[record.of].fields) if is_enum else ()

    @property
    def enum_classes(self) -> frozenset[int]:
        """The classes that have the members of enums."""
        return frozenset(record.of for record in self.types if record.kind == INT and record.of)

    @property
    def builtins(self) -> int:
        """The number of built-in classes at the start: fewer in a program of an older lfield."""
        new = bool(self.classes) and len(self.classes[0].fields) > OTHERS
        return len(BUILTIN_CLASSES) if new else OLDEST_BUILTINS

    @property
    def others(self) -> dict[int, int]:
        """By class, the field with suppressed exceptions of other calls of a `together`."""
        if self.builtins == OLDEST_BUILTINS:
            return {}
        own = enumerate(self.classes[self.builtins :], self.builtins)
        last = {
            i: len(record.fields) - 1
            for i, record in own
            if record.fields[-1:] and not record.fields[-1].name
        }
        return {**dict.fromkeys(range(self.builtins), OTHERS), **last}


class Program:
    """A program in memory: the core, its debug information, its identity, and the code as quads."""

    def __init__(self, core: Core, debug: Debug, digest: bytes) -> None:
        self.core = core
        self.debug = debug
        #: The SHA-256 of the encoded core: 32 bytes.
        self.digest = digest

    def with_sources(self, more: Iterable[SourceText]) -> Program:
        """The same program with further sources, which have no methods."""
        return Program(self.core, Debug(self.debug.methods, (*self.debug.sources, *more)), self.digest)

    @cached_property
    def quads(self) -> tuple[Quad, ...]:
        """The code, decoded."""
        return tuple(Quad(*row) for row in _QUAD.iter_unpack(self.core.code))

    @cached_property
    def builtins(self) -> int:
        """The number of built-in classes at the start."""
        return self.core.builtins

    @cached_property
    def others(self) -> dict[int, int]:
        """By class, the field with suppressed exceptions of other calls of a `together`."""
        return self.core.others

    @cached_property
    def has_limits(self) -> bool:
        """Whether the program has a `within`, so that a time limit may skip a catch."""
        return any(h.kind == LIMIT for method in self.core.methods for h in method.handlers)

    @cached_property
    def has_reserves(self) -> bool:
        """Whether the program has a `reserve`."""
        return any(h.kind == RESERVED for method in self.core.methods for h in method.handlers)

    @cached_property
    def has_stops(self) -> bool:
        """Whether the program stops coordinators, so that a limit is around the `init` of each."""
        return any(quad.op == _SEQ_STOP for quad in self.quads)

    @cached_property
    def kinds(self) -> tuple[frozenset[int], ...]:
        """For each class, the classes of its objects: itself, its parent, Exception."""
        own = [frozenset((0, index)) for index in range(len(self.core.classes))]
        for name, parent in BUILTIN_PARENTS.items():
            own[BUILTIN_CLASSES.index(name)] |= own[BUILTIN_CLASSES.index(parent)]
        return tuple(own)

    @cached_property
    def class_index(self) -> dict[str, int]:
        """Class, resource and coordinator indexes by name."""
        return {record.name: i for i, record in enumerate(self.core.classes)}

    @property
    def units(self) -> dict[str, UnitKind]:
        """Deployable types: name to "resource" or "coordinator" (and "class" for the others)."""
        return {c.name: c.kind for c in self.core.classes[self.builtins :]}

    def method_name(self, index: int) -> str:
        """`Owner.name` of a method, for tracebacks and listings."""
        record = self.core.methods[index]
        return f"{self.core.classes[record.owner].name}.{record.name}"

    def line(self, method: int, pc: int) -> tuple[str, int]:
        """File name and line of an instruction; ('', 0) without debug information."""
        if method >= len(self.debug.methods):
            return "", 0
        info = self.debug.methods[method]
        line = 0
        for at, number in info.lines:
            if at > pc:
                break
            line = number
        return self.debug.sources[info.source].name, line


def encode_quads(quads: list[Quad]) -> bytes:
    """Quads as bytes: four little-endian 32-bit integers each."""
    return b"".join(_QUAD.pack(*quad) for quad in quads)

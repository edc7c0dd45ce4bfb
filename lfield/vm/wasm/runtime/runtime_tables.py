"""Tables of a program for the functions of the runtime: positions and target types of references, as bytes.

All numbers are little-endian, 32 bits; addresses count from the start of the tables.

      0   by kind (0 to 15), the address of its records
     64   by kind, its number of records
    128   the number of team members, and the address of their classes, by number
    136   the number of classes, and the address of one bit per pair: whether one is a subclass of the other
    144   records, 16 bytes each: a number, the number of references (-1: every word after the header), the
          address of their list, another number
    ...   lists: for each reference its offset in bytes, and its target type

For the copier the number of a record is the offset of the reference that is not copied, in bytes (0: none);
for the verifier the size of the object in words (0: any, -1: no such object). The other number is the target
type of the elements of an array of references.

The positions of coordinators have their own tables:

      0   the number of classes, and the address of one byte for each: 1 for coordinators
      8   the number of instructions, and the address of one number for each: the method that it calls,
          -1: none, -2: a coordinator may migrate from here
     16   the address of three numbers for each method: its start and end, and 1 if it reserves
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

from msgspec import Struct

from lfield.bytecode.program import Program
from lfield.vm.memory.heap_schema import Expected, HeapSchema, SuspensionPoints
from lfield.vm.memory.layout import ARRAY, ROOTS, Layouts

_KINDS = 16
_HEAD = struct.Struct("<36i")
_RECORD = struct.Struct("<iiii")
_PAIR = struct.Struct("<ii")
_SCHEMA_HEAD = struct.Struct("<5i")


class HeaderRecord(Struct, frozen=True):
    """Records of the objects with one lower header half; without `references`, every word after the header is
    a reference.
    """

    number: int
    references: Expected | None
    elements: int = 0


#: No such object exists.
_NOTHING = HeaderRecord(-1, ())


def layout_tables(layouts: Layouts) -> bytes:
    """The tables for collector and copier. Record 0 of kind 0 has the roots in the header of a block."""
    records = {0: HeaderRecord(0, _plain(ROOTS))}
    for half, offsets in layouts.offsets.items():
        records[half] = HeaderRecord(8 * layouts.uncopied.get(half, 0), _plain(offsets))
    for index, holds_references in enumerate(layouts.array_references):
        if holds_references:
            records[ARRAY | index << 8] = HeaderRecord(0, None)
    return _tables(records, (), b"", 0)


def schema_tables(schema: HeapSchema) -> bytes:
    """The tables for the verifier."""
    records = {}
    for half, size in schema.sizes.items():
        expects = schema.expects.get(half)
        elements = schema.of_elements(half) if expects is None else 0
        records[half] = HeaderRecord(size, expects, elements)
    classes = len(schema.program.core.classes)
    return _tables(records, tuple(schema.members), _kinds_of(schema.program), classes)


def suspension_tables(suspension_points: SuspensionPoints) -> bytes:
    """The instructions at which coordinators migrate."""
    core, quads = suspension_points.program.core, suspension_points.program.quads
    calls = [
        -2 if pc in suspension_points.portal_calls else suspension_points.calls.get(pc, -1)
        for pc in range(len(quads))
    ]
    methods = [
        n for i, m in enumerate(core.methods) for n in (m.entry, m.end, int(i in suspension_points.reserve))
    ]
    classes = bytes(i in suspension_points.coordinators for i in range(len(core.classes)))
    classes += bytes(-len(classes) % 4)
    calls_at = _SCHEMA_HEAD.size + len(classes)
    head = len(core.classes), _SCHEMA_HEAD.size, len(quads), calls_at, calls_at + 4 * len(calls)
    numbers = struct.pack(f"<{len(calls) + len(methods)}i", *calls, *methods)
    return _SCHEMA_HEAD.pack(*head) + classes + numbers


def _plain(offsets: tuple[int, ...]) -> Expected:
    return tuple((offset, 0) for offset in offsets)


def _kinds_of(program: Program) -> bytes:
    """One bit per pair of class and superclass."""
    classes = len(program.core.classes)
    bits = sum(1 << found * classes + kind for found, kinds in enumerate(program.kinds) for kind in kinds)
    return bits.to_bytes(classes * classes + 7 >> 3, "little")


def _tables(
    records: Mapping[int, HeaderRecord], members: tuple[int, ...], kinds: bytes, classes: int
) -> bytes:
    """Head, records, lists, members and kinds, in this order."""
    counts = [
        1 + max((half >> 8 for half in records if half & 0xFF == kind), default=-1) for kind in range(_KINDS)
    ]
    starts = [_HEAD.size + _RECORD.size * sum(counts[:kind]) for kind in range(_KINDS)]
    lists_at = _HEAD.size + _RECORD.size * sum(counts)
    rows, lists = bytearray(), bytearray()
    for kind, count in enumerate(counts):
        for index in range(count):
            record = records.get(kind | index << 8, _NOTHING)
            references = record.references
            row = record.number, -1 if references is None else len(references), lists_at + len(lists)
            rows += _RECORD.pack(*row, record.elements)
            lists += b"".join(_PAIR.pack(8 * offset, expected) for offset, expected in references or ())
    members_at = lists_at + len(lists)
    kinds_at = members_at + 4 * len(members)
    head = _HEAD.pack(*starts, *counts, len(members), members_at, classes, kinds_at)
    return head + rows + lists + struct.pack(f"<{len(members)}i", *members) + kinds

"""What the functions of the runtime must know of a program, as bytes: where references are and lead to.

All numbers are little-endian, 32 bits; addresses count from the beginning of the tables.

      0   by kind (0 to 7), the address of its records
     32   by kind, how many records it has
     64   how many members the team has, and the address of their classes, by number
     72   how many classes there are, and the address of one bit for each two: whether one is a kind of other
     80   records, 16 bytes each: a number, how many references (-1: every word behind the header), the
          address of their list, another number
    ...   lists: of each reference its offset in bytes, and what it must lead to

The number of a record is for the copier the offset of the reference that stays behind, in bytes (0: none),
for the soundness check the size of the thing in words (0: any, -1: there is no such thing). The other number
is what every element of an array of references must lead to.

Where coordinators stand is in tables of its own:

      0   how many classes there are, and the address of one byte for each: 1, it is a coordinator's
      8   how many instructions there are, and the address of one number for each: the method that it calls,
          -1: it calls none, -2: a coordinator may travel from here
     16   the address of three numbers for each method: where it begins and ends, and 1, if it reserves
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass

from lfield.bytecode.program import Program
from lfield.vm.memory.layout import ARRAY, ROOTS, Layouts
from lfield.vm.memory.shapes import Expected, Shapes, Stances

_KINDS = 8
_HEAD = struct.Struct("<20i")
_RECORD = struct.Struct("<iiii")
_PAIR = struct.Struct("<ii")
_STANCE_HEAD = struct.Struct("<5i")


@dataclass(frozen=True, slots=True)
class Record:
    """What is known of the things with one half of a header; no `references`: every word behind it is one."""

    number: int
    references: Expected | None
    elements: int = 0


#: There is no such thing.
_NOTHING = Record(-1, ())


def layout_tables(layouts: Layouts) -> bytes:
    """For collector and copier. The record 0 of kind 0 has the roots in the header of a block."""
    records = {0: Record(0, _plain(ROOTS))}
    for half, offsets in layouts.offsets.items():
        records[half] = Record(8 * layouts.stays.get(half, 0), _plain(offsets))
    for index, holds_references in enumerate(layouts.array_references):
        if holds_references:
            records[ARRAY | index << 8] = Record(0, None)
    return _tables(records, (), b"", 0)


def shape_tables(shapes: Shapes) -> bytes:
    """For the soundness check."""
    records = {}
    for half, size in shapes.sizes.items():
        expects = shapes.expects.get(half)
        elements = shapes.of_elements(half) if expects is None else 0
        records[half] = Record(size, expects, elements)
    classes = len(shapes.program.core.classes)
    return _tables(records, tuple(shapes.members), _kinds_of(shapes.program), classes)


def stance_tables(stances: Stances) -> bytes:
    """Where coordinators stand."""
    core, quads = stances.program.core, stances.program.quads
    calls = [-2 if pc in stances.portal_calls else stances.calls.get(pc, -1) for pc in range(len(quads))]
    methods = [n for i, m in enumerate(core.methods) for n in (m.entry, m.end, int(i in stances.reserve))]
    classes = bytes(i in stances.coordinators for i in range(len(core.classes)))
    classes += bytes(-len(classes) % 4)
    calls_at = _STANCE_HEAD.size + len(classes)
    head = len(core.classes), _STANCE_HEAD.size, len(quads), calls_at, calls_at + 4 * len(calls)
    numbers = struct.pack(f"<{len(calls) + len(methods)}i", *calls, *methods)
    return _STANCE_HEAD.pack(*head) + classes + numbers


def _plain(offsets: tuple[int, ...]) -> Expected:
    return tuple((offset, 0) for offset in offsets)


def _kinds_of(program: Program) -> bytes:
    """One bit for each class and each class that it may be a kind of."""
    classes = len(program.core.classes)
    bits = sum(1 << found * classes + kind for found, kinds in enumerate(program.kinds) for kind in kinds)
    return bits.to_bytes(classes * classes + 7 >> 3, "little")


def _tables(records: Mapping[int, Record], members: tuple[int, ...], kinds: bytes, classes: int) -> bytes:
    """Head, records, lists, members, kinds; they are put one behind the other in this order."""
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

"""The object dictionary of the foreign drive, in variants: manufacturers omit parts or fix them."""

from __future__ import annotations

from dataclasses import dataclass

import canopen
from canopen.objectdictionary import ODRecord, ODVariable
from canopen.objectdictionary import datatypes as t

U8, U16, U32, I8, I16, I32 = t.UNSIGNED8, t.UNSIGNED16, t.UNSIGNED32, t.INTEGER8, t.INTEGER16, t.INTEGER32
UNUSED, NO_REMOTE = 1 << 31, 1 << 30

#: Objects that can be mapped to a PDO: index -> bits.
MAPPABLE = {
    0x6040: 16, 0x6041: 16, 0x6060: 8, 0x6061: 8, 0x6064: 32, 0x606C: 32, 0x6077: 16, 0x607A: 32, 0x6081: 32,
    0x60FF: 32,
}  # fmt: skip


@dataclass(frozen=True)
class Variant:
    """One manufacturer's reading of CiA 301. PDOs are lists of indices."""

    name: str
    no_remote: bool = False
    timer: bool = True
    sync: bool = True
    fixed: bool = False
    told: tuple[tuple[int, ...], ...] = ((0x6041,), (0x6041, 0x6061), (0x6064, 0x606C), (0x6041, 0x6077))
    taken: tuple[tuple[int, ...], ...] = ((0x6040,), (0x6040, 0x6060), (0x607A,), (0x60FF,))


#: As predefined by CiA 402-3: the control word is in each.
PREDEFINED = {
    "told": ((0x6041,), (0x6041, 0x6061), (0x6041, 0x6064), (0x6041, 0x606C)),
    "taken": ((0x6040,), (0x6040, 0x6060), (0x6040, 0x607A), (0x6040, 0x60FF)),
}
VARIANTS = (
    Variant("strict"),
    Variant("no remote frames", no_remote=True),
    Variant("no event timer", timer=False),
    Variant("neither timer nor sync", timer=False, sync=False),
    Variant("fixed", fixed=True, no_remote=True, **PREDEFINED),
    Variant(
        "fixed in another order",
        fixed=True,
        timer=False,
        told=((0x6061,), (0x606C, 0x6061), (0x6077,), (), (0x6064, 0x6041)),
        taken=((0x6081,), (0x60FF, 0x6060, 0x6040), (), (), (0x607A, 0x6040)),
    ),
)
UNFIT = Variant("fixed, without a velocity", fixed=True, told=((0x6041,), (0x6041, 0x6064)))


def entry(index: int) -> int:
    return index << 16 | MAPPABLE[index]


def dictionary(variant: Variant, node: int) -> canopen.ObjectDictionary:
    od = canopen.ObjectDictionary()

    def add(index, subindex, kind, value, access="rw", *, record=False):
        variable = ODVariable(f"{index:04X}.{subindex}", index, subindex)
        variable.data_type, variable.default, variable.access_type = kind, value, access
        if not record:
            od.add_object(variable)
            return
        if index not in od:
            od.add_object(ODRecord(f"{index:04X}", index))
        od[index].add_member(variable)

    for index, kind, value, access in (
        (0x1000, U32, 0x0002_0192, "ro"), (0x1001, U8, 0, "ro"), (0x1017, U16, 0, "rw"),
        (0x603F, U16, 0, "ro"), (0x6040, U16, 0, "rw"), (0x6041, U16, 0x0250, "ro"), (0x605A, I16, 2, "rw"),
        (0x6007, I16, 1, "rw"), (0x6060, I8, 0, "rw"), (0x6061, I8, 0, "ro"), (0x6064, I32, 0, "ro"),
        (0x606C, I32, 0, "ro"), (0x6077, I16, 0, "ro"), (0x607A, I32, 0, "rw"), (0x607F, U32, 500_000, "rw"),
        (0x6081, U32, 20_000, "rw"), (0x6083, U32, 100_000, "rw"), (0x6084, U32, 100_000, "rw"),
        (0x6085, U32, 200_000, "rw"), (0x6098, I8, 0, "rw"), (0x60FF, I32, 0, "rw"),
        (0x6502, U32, 0b1_1010_0101, "ro"),
    ):  # fmt: skip
        add(index, 0, kind, value, access)
    if variant.sync:
        add(0x1005, 0, U32, 0x80)
    add(0x1016, 0, U8, 1, "ro", record=True)
    add(0x1016, 1, U32, 0, record=True)
    for subindex, value in enumerate((2, 0xFEED, 0x402)):
        add(0x1018, subindex, U8 if subindex == 0 else U32, value, "ro", record=True)
    for subindex, value in enumerate((2, 10_000, 10_000)):
        add(0x6099, subindex, U8 if subindex == 0 else U32, value, record=True)
    for record, mapping, first, pdos in (
        (0x1800, 0x1A00, 0x180, variant.told),
        (0x1400, 0x1600, 0x200, variant.taken),
    ):
        for number, indices in enumerate(pdos):
            # Only the first four have predefined ids (CiA 301, predefined connection set).
            cob = first + 0x100 * number + node if number < 4 else UNUSED
            add(record + number, 0, U8, 5, "ro", record=True)
            add(record + number, 1, U32, cob | (NO_REMOTE if variant.no_remote else 0), record=True)
            add(record + number, 2, U8, 255, record=True)
            if record == 0x1800:
                add(record + number, 3, U16, 100, record=True)
                if variant.timer:
                    add(record + number, 5, U16, 0, record=True)
            access = "ro" if variant.fixed else "rw"
            add(mapping + number, 0, U8, len(indices), access, record=True)
            slots = [entry(index) for index in indices] + [0] * (0 if variant.fixed else 8 - len(indices))
            for position, value in enumerate(slots, 1):
                add(mapping + number, position, U32, value, access, record=True)
    return od

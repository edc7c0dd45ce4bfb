"""Verifies operands against the table: indexes in range, values of the right type."""

from __future__ import annotations

from lfield.bytecode.opcodes import BY_CODE, Opcode, Operand
from lfield.bytecode.program import (
    BOOLEAN,
    DEVICE,
    INT,
    NULL,
    OBJECT,
    REAL,
    STRING,
    ClassRecord,
    Core,
    MethodRecord,
    Quad,
)
from lfield.bytecode.verifier.type_table import TypeTable, scope_of
from lfield.errors import ProgramFileError

_EXACT = {"boolean": BOOLEAN, "int": INT, "real": REAL, "string": STRING}
_CONSTANT_TYPES = {bool: BOOLEAN, int: INT, float: REAL, type(None): NULL}
#: By opcode, the position of the last source operand: the only one that may be a constant.
_LAST_SOURCE = {
    code: max((i for i, operand in enumerate(row.operands) if operand.role in "SV"), default=-1)
    for code, row in BY_CODE.items()
}


class MethodView:
    """One method under verification, and the records that its instructions may refer to."""

    def __init__(self, core: Core, types: TypeTable, index: int) -> None:
        self.core = core
        self.types = types
        self.index = index
        self.method: MethodRecord = core.methods[index]
        self.scope = scope_of(core.classes[self.method.owner])
        self._counts = {
            "L": self.method.end,
            "C": len(core.classes),
            "T": len(core.types),
            "M": len(core.methods),
            "K": len(core.constants),
            "I": len(core.device_calls),
        }

    def refused(self, pc: int, reason: str) -> ProgramFileError:
        """The error to raise for an instruction."""
        return ProgramFileError(reason, method=self.method.name, pc=pc)

    def can_access(self, record: ClassRecord) -> bool:
        """Whether code of this method may create objects of a class and call their methods (chapter IV).

        This restricts output and devices to resources, and portals to coordinators: code of one side cannot
        reach the other.
        """
        return scope_of(record) in ("global", self.scope)

    def slot(self, number: int, pc: int) -> int:
        """The type of a slot."""
        if not 0 <= number < len(self.method.slots):
            raise self.refused(pc, f"there is no slot {number}")
        return self.method.slots[number]

    def target(self, number: int, pc: int) -> int:
        """The type of a slot that is written; slot 0 is the object and is never written."""
        if number == 0:
            raise self.refused(pc, "slot 0 cannot be written")
        return self.slot(number, pc)

    def source(self, number: int, pc: int) -> int:
        """The type of a slot or constant."""
        if number >= 0:
            return self.slot(number, pc)
        if -number > len(self.core.constants):
            raise self.refused(pc, f"there is no constant {-1 - number}")
        value = self.core.constants[-1 - number]
        if isinstance(value, str):
            raise self.refused(pc, "a string constant is not an operand; use lds")
        return _CONSTANT_TYPES[type(value)]

    def check_operands(self, pc: int, row: Opcode, quad: Quad) -> None:
        """Check roles and kinds of all operands of an instruction; unused ones must be 0."""
        for position, number in enumerate(quad[1:]):
            if position >= len(row.operands):
                if number:
                    raise self.refused(pc, f"{row.name} has an operand too many")
            else:
                self._check_operand(pc, row, position, number)

    def _check_operand(self, pc: int, row: Opcode, position: int, number: int) -> None:
        operand = row.operands[position]
        if operand.role == "D":
            kind = self.target(number, pc)
        elif operand.role == "V" or (operand.role == "S" and position != _LAST_SOURCE[row.code]):
            kind = self.slot(number, pc)
        elif operand.role == "S":
            kind = self.source(number, pc)
        else:
            self._check_index(pc, operand, number)
            return
        if not self._has_kind(kind, operand):
            raise self.refused(pc, f"operand {position + 1} of {row.name} is of a wrong type")

    def _check_index(self, pc: int, operand: Operand, number: int) -> None:
        if operand.role == "F":
            return  # its meaning depends on another operand's class, so the rule of the instruction checks it
        lowest = self.method.entry + 1 if operand.role == "L" else 0
        if not lowest <= number < self._counts[operand.role]:
            raise self.refused(pc, f"operand {operand.role} {number} does not exist")

    def _has_kind(self, actual: int, operand: Operand) -> bool:
        exact = _EXACT.get(operand.kind)
        if exact is not None:
            # A written slot must have exactly the type; a slot that is read may also be null.
            return actual == exact if operand.role == "D" else self.types.fits(actual, exact)
        if operand.kind == "ref":
            return self.types.is_reference(actual)
        if operand.role == "D" or operand.kind in ("same", "any"):
            return True  # decided by the rule of the instruction
        return self.types.kind(actual) == OBJECT if operand.kind == "object" else self.types.is_array(actual)

    def field_type(self, pc: int, holder: int, number: int) -> int:
        """The type of a field of the object in a slot."""
        fields = self.core.classes[self.types.record(self.slot(holder, pc)).of].fields
        devices = self.scope == "resource"
        if not 0 <= number < len(fields) or (fields[number].type == DEVICE and not devices):
            raise self.refused(pc, f"there is no field {number} to read or write")
        return fields[number].type

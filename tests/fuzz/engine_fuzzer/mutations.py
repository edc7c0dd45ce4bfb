"""Programs that no compiler produces: compiled programs with random changes that the verifier accepts.

Jumps have any target in a method, so that loops have several entries; constants have any bits; handlers and
calls are at places where L has none.
"""

from __future__ import annotations

import hashlib
import random
from bisect import bisect
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec

from lfield.bytecode.encoding import encode_core
from lfield.bytecode.opcodes import BY_CODE, BY_NAME, TABLE
from lfield.bytecode.program import Core, Handler, MethodRecord, Program, Quad, encode_quads
from lfield.bytecode.verifier.instructions import check_method
from lfield.bytecode.verifier.methods import check_methods
from lfield.bytecode.verifier.operands import MethodView
from lfield.bytecode.verifier.record_checks import check_constants
from lfield.bytecode.verifier.type_table import TypeTable
from lfield.errors import ProgramFileError
from lfield.vm.memory.word_codec import real_from_bits
from lfield.vm.wasm.lowering.module_lowering import called_methods

#: New values of constants.
_INTS = (0, 1, -1, 2, 3, 7, 63, 64, 1 << 31, (1 << 53) + 1, (1 << 63) - 1, -(1 << 63))
_REALS = (0.0, -0.0, 1.0, -1.0, 0.5, 5e-324, 1e-308, 1.7976931348623157e308, float("inf"), float("-inf"))
#: NaNs with bits that no arithmetic gives.
_NANS = (real_from_bits(0x7FF8_0000_0000_0001), real_from_bits(-1), real_from_bits(0x7FF4_0000_0000_0000))

#: Instructions that take operands of the same roles and kinds, in families.
_FAMILIES: dict[tuple[object, ...], list[int]] = {}
for _row in TABLE:
    if not _row.leaves_engine:
        _FAMILIES.setdefault((_row.operands, _row.argument_kinds, _row.result_kind), []).append(_row.code)
_FRAME, _LOAD_STRING = BY_NAME["frame"].code, BY_NAME["lds"].code


@dataclass(frozen=True)
class Edit:
    """One change: another instruction, constant or method at `at`."""

    at: int
    value: Quad | MethodRecord | bool | int | float | str | None
    #: True if the constant at `at` becomes `value`.
    constant: bool = False

    def __str__(self) -> str:
        what = (
            "constant"
            if self.constant
            else "method"
            if isinstance(self.value, MethodRecord)
            else "instruction"
        )
        return f"{what} {self.at} is {self.value}"


def edited(program: Program, edits: Sequence[Edit], accepted: int = 0) -> Program | None:
    """The program after these changes, of which the first are already accepted; None if it is rejected.

    Only the parts that the new changes affect are verified.
    """
    quads, constants = list(program.quads), list(program.core.constants)
    methods = list(program.core.methods)
    for edit in edits:
        if edit.constant:
            assert not isinstance(edit.value, MethodRecord | Quad)
            constants[edit.at] = edit.value
        elif isinstance(edit.value, MethodRecord):
            methods[edit.at] = edit.value
        else:
            assert isinstance(edit.value, Quad)
            quads[edit.at] = edit.value
    core = program.core
    new = Core(
        core.types, tuple(constants), core.classes, tuple(methods), core.device_calls, encode_quads(quads)
    )
    digest = hashlib.sha256(encode_core(Program(new, program.debug, b""))).digest()
    made = Program(new, program.debug, digest)
    try:
        _verify(made, edits[accepted:])
    except ProgramFileError:
        return None
    return made


def _verify(program: Program, edits: Sequence[Edit]) -> None:
    """Verify the parts of a program that these changes affect; a constant keeps its type."""
    check_constants(program.core)
    if any(isinstance(edit.value, MethodRecord) for edit in edits):
        check_methods(program.core)
    types = TypeTable(program.core)
    for index in changed_methods(program, edits):
        check_method(MethodView(program.core, types, index), program.quads)


def changed_methods(program: Program, edits: Sequence[Edit]) -> set[int]:
    """The methods whose code a change affects, including those with a changed constant."""
    entries = [method.entry for method in program.core.methods]
    found: set[int] = set()
    for edit in edits:
        if edit.constant:
            used = -1 - edit.at
            users = [pc for pc, quad in enumerate(program.quads) if used in quad or _loads(quad, edit)]
            found.update(bisect(entries, pc) - 1 for pc in users)
        else:
            found.add(edit.at if isinstance(edit.value, MethodRecord) else bisect(entries, edit.at) - 1)
    return found


def _loads(quad: Quad, edit: Edit) -> bool:
    return quad.op == _LOAD_STRING and quad.b == edit.at


def random_edits(
    program: Program,
    rng: random.Random,
    count: int,
    latest: Program | None = None,
    earlier: Sequence[Edit] = (),
) -> tuple[Program, list[Edit]]:
    """Apply up to `count` random changes that the verifier accepts; returns the program and the changes.

    The changes follow `earlier` ones, whose result is `latest`.
    """
    edits, found = list(earlier), program if latest is None else latest
    for _ in range(3 * count):
        if len(edits) >= len(earlier) + count:
            break
        edit = _drawn(found, rng)
        changed = None if edit is None else edited(program, [*edits, edit], len(edits))
        if edit is not None and changed is not None:
            edits.append(edit)
            found = changed
    return found, edits


def _drawn(program: Program, rng: random.Random) -> Edit | None:
    core = program.core
    number = rng.choice(called_methods(program))
    method = core.methods[number]
    at = rng.randrange(method.entry, method.end)
    match rng.randrange(12):
        case 0 | 1:
            return _constant(program, rng)
        case 2:
            return Edit(number, _other_method(method, rng))
        case 3:
            # Duplicate another instruction of the method here.
            other = program.quads[rng.randrange(method.entry, method.end)]
            return Edit(at, other) if _FRAME not in (other.op, program.quads[at].op) else None
        case 4:
            target = rng.randrange(method.entry + 1, method.end)
            return Edit(at, Quad(BY_NAME["jmp"].code, target, 0, 0))
        case 5 | 6:
            return _family(program, at, rng)
    return _operand(program, method, at, rng)


def _constant(program: Program, rng: random.Random) -> Edit | None:
    if not program.core.constants:
        return None
    at = rng.randrange(len(program.core.constants))
    match program.core.constants[at]:
        case bool(value):
            return Edit(at, not value, constant=True)
        case int():
            return Edit(at, rng.choice((*_INTS, rng.randrange(-10, 10))), constant=True)
        case float():
            return Edit(at, rng.choice((*_REALS, *_NANS, rng.uniform(-4.0, 4.0))), constant=True)
        case str():
            return Edit(at, rng.choice(("", "x", "ß" * 9, "1.5", "-9223372036854775808")), constant=True)
    return None


def _other_method(method: MethodRecord, rng: random.Random) -> MethodRecord:
    """The method with another `synchronized`, or with a moved handler."""
    if not method.handlers or rng.random() < 0.4:
        return msgspec.structs.replace(method, synchronized=not method.synchronized)
    handlers = list(method.handlers)
    at = rng.randrange(len(handlers))
    old = handlers[at]
    pc = rng.randrange(method.entry + 1, method.end)
    name = rng.choice(("start", "end", "target"))
    handlers[at] = Handler(*[pc if f == name else getattr(old, f) for f in Handler.__struct_fields__])
    if rng.random() < 0.3:
        rng.shuffle(handlers)
    return msgspec.structs.replace(method, handlers=tuple(handlers))


def _family(program: Program, at: int, rng: random.Random) -> Edit | None:
    """Another instruction with the same kinds of operands."""
    quad = program.quads[at]
    row = BY_CODE[quad.op]
    known = _FAMILIES.get((row.operands, row.argument_kinds, row.result_kind), [])
    others = [code for code in known if code != quad.op]
    return Edit(at, quad._replace(op=rng.choice(others))) if others else None


def _operand(program: Program, method: MethodRecord, at: int, rng: random.Random) -> Edit | None:
    """Another slot of the same type, another constant of the kind, another label."""
    quad = program.quads[at]
    operands = BY_CODE[quad.op].operands
    if not operands or quad.op == _FRAME:
        return None
    place = rng.randrange(len(operands))
    role, old = operands[place].role, quad[1 + place]
    new = _replaced(program, method, role, old, rng)
    if new is None or new == old:
        return None
    numbers = list(quad)
    numbers[1 + place] = new
    return Edit(at, Quad(*numbers))


def _replaced(program: Program, method: MethodRecord, role: str, old: int, rng: random.Random) -> int | None:
    if role == "L":
        return rng.randrange(method.entry + 1, method.end)
    if role not in ("D", "V", "S"):
        return None
    if old < 0:
        constants = program.core.constants
        kind = type(constants[-1 - old])
        return rng.choice([-1 - i for i, value in enumerate(constants) if type(value) is kind])
    kind_of = method.slots[old]
    return rng.choice([i for i, of in enumerate(method.slots) if of == kind_of])
